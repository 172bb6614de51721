// Turns chosen or dropped files into one archive or video to send.

import { tar, type Member } from "./tar";

/**
 * An archive or a video, and its name. files: the number of packed files, null if a single archive or video was chosen.
 * identity: path, size and time of each file, which distinguish the capture from others.
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
// Files that operating systems create in folders.
const LITTER = /(^|\/)(\.|__MACOSX\/|Thumbs\.db$|desktop\.ini$)/;

/** Pack files with their paths into one capture. Returns null if there are no files. */
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

/** Return the files of an input element, which are single files or those of a folder. */
export function pickedFiles(list: FileList): Member[] {
  return [...list].map((file) => ({ path: file.webkitRelativePath || file.name, file }));
}

/** Return the files of a drop, with those inside folders. */
export async function droppedFiles(items: DataTransferItemList): Promise<Member[]> {
  // The entries are read at once, because the list is empty after the first await.
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
    // Browsers return a hundred entries at a time, and none at the end.
    const batch = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (batch.length === 0) return found;
    found.push(...(await Promise.all(batch.map(walk))).flat());
  }
}

/** Strip the folder that contains all files, if there is one. */
function withoutTop(members: Member[]): { folder: string | null; inside: Member[] } {
  const tops = new Set(members.map(({ path }) => (path.includes("/") ? path.slice(0, path.indexOf("/")) : "")));
  const [top] = tops;
  if (tops.size !== 1 || !top) return { folder: null, inside: members };
  return { folder: top, inside: members.map(({ path, file }) => ({ path: path.slice(top.length + 1), file })) };
}

function stem(name: string): string {
  return name.replace(/\.(zip|tar|tar\.gz|tgz|tar\.zst|tzst|mp4|m4v|3gp|mov|webm|mkv)$/i, "");
}
