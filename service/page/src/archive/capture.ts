// What a person picked or dropped, as one archive or video to send.

import { tar, type Member } from "./tar";

/**
 * An archive or a video, and what it is called. files: how many it was made of; null where it was one already.
 * identity: path, size and time of each file, which tell the capture from others.
 */
export interface Capture {
  name: string;
  archive: Blob;
  identity: string[];
  type: string;
  files: number | null;
}

const TYPES: [RegExp, string][] = [
  [/\.zip$/i, "application/zip"],
  [/\.tar$/i, "application/x-tar"],
  [/\.(tar\.gz|tgz)$/i, "application/gzip"],
  [/\.(tar\.zst|tzst)$/i, "application/zstd"],
  [/\.(mp4|m4v|3gp)$/i, "video/mp4"],
  [/\.mov$/i, "video/quicktime"],
  [/\.webm$/i, "video/webm"],
  [/\.mkv$/i, "video/x-matroska"],
];
// What systems leave behind in folders.
const LITTER = /(^|\/)(\.|__MACOSX\/|Thumbs\.db$|desktop\.ini$)/;

/** Files with their paths, as one capture; null if there is none. */
export function captureOf(members: Member[]): Capture | null {
  const kept = members.filter(({ path }) => !LITTER.test(path));
  if (kept.length === 0) return null;
  const [first] = kept;
  const identity = kept.map(({ path, file }) => `${path} ${file.size} ${file.lastModified}`);
  const type = TYPES.find(([ending]) => ending.test(first!.path))?.[1];
  if (kept.length === 1 && type !== undefined) {
    return { name: stem(first!.file.name), archive: first!.file, identity, type, files: null };
  }
  const { folder, inside } = withoutTop(kept);
  const archive = tar(inside);
  return { name: folder ?? "photographs", archive, identity, type: "application/x-tar", files: inside.length };
}

/** The files of an input element: single ones, or a folder's. */
export function pickedFiles(list: FileList): Member[] {
  return [...list].map((file) => ({ path: file.webkitRelativePath || file.name, file }));
}

/** The files of a drop, also those inside of folders. */
export async function droppedFiles(items: DataTransferItemList): Promise<Member[]> {
  // All at once: after the first wait the list is empty.
  const entries = [...items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  return (await Promise.all(entries.map(walk))).flat();
}

async function walk(entry: FileSystemEntry): Promise<Member[]> {
  const path = entry.fullPath.replace(/^\//, "");
  if (entry.isFile) {
    const file = await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject));
    return [{ path, file }];
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  const found: Member[] = [];
  for (;;) {
    // A hundred at a time, then none.
    const batch = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (batch.length === 0) return found;
    found.push(...(await Promise.all(batch.map(walk))).flat());
  }
}

/** The files without the one folder that holds them all, if there is one. */
function withoutTop(members: Member[]): { folder: string | null; inside: Member[] } {
  const tops = new Set(members.map(({ path }) => (path.includes("/") ? path.slice(0, path.indexOf("/")) : "")));
  const [top] = tops;
  if (tops.size !== 1 || !top) return { folder: null, inside: members };
  return { folder: top, inside: members.map(({ path, file }) => ({ path: path.slice(top.length + 1), file })) };
}

function stem(name: string): string {
  return name.replace(/\.(zip|tar|tar\.gz|tgz|tar\.zst|tzst|mp4|m4v|3gp|mov|webm|mkv)$/i, "");
}
