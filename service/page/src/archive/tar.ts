// Packs a folder as a tar (POSIX.1-2001). The blob only refers to the files, so gigabytes of photographs need no memory:
// the browser reads them when it sends them. A zip would need the checksum of each file first.

const BLOCK = 512;

export interface Member {
  /** The path inside the archive, with slashes. */
  path: string;
  file: File;
}

/** Pack files into an archive. */
export function tar(members: Member[]): Blob {
  const parts: BlobPart[] = [];
  for (const { path, file } of members) {
    if (!fits(path)) parts.push(...paxHeader(path));
    parts.push(header(fits(path) ? path : "long-name", file.size, "0", file.lastModified), file, padding(file.size));
  }
  return new Blob([...parts, new Uint8Array(2 * BLOCK)], { type: "application/x-tar" });
}

/** Return whether a plain header can hold a path. */
function fits(path: string): boolean {
  return path.length <= 100 && /^[\x20-\x7e]*$/.test(path);
}

/** Return an extra member that holds the next member's path. */
function paxHeader(path: string): BlobPart[] {
  const record = new TextEncoder().encode(` path=${path}\n`);
  let length = record.length + 1;
  while (`${length}`.length + record.length !== length) length = `${length}`.length + record.length;
  return [header("path", length, "x", 0), `${length}`, record, padding(length)];
}

function header(path: string, size: number, type: string, milliseconds: number): Uint8Array<ArrayBuffer> {
  const block = new Uint8Array(BLOCK);
  const write = (text: string, at: number) => new TextEncoder().encodeInto(text, block.subarray(at));
  const octal = (value: number, digits: number) => Math.floor(value).toString(8).padStart(digits, "0");
  write(path, 0);
  write(octal(0o644, 7), 100);
  write(octal(0, 7), 108);
  write(octal(0, 7), 116);
  write(octal(size, 11), 124);
  write(octal(Math.max(0, milliseconds / 1000), 11), 136);
  write(" ".repeat(8), 148); // the checksum counts its own field as blanks
  write(type, 156);
  write("ustar\x0000", 257);
  write(`${octal(block.reduce((sum, byte) => sum + byte, 0), 6)}\0 `, 148);
  return block;
}

function padding(size: number): Uint8Array<ArrayBuffer> {
  return new Uint8Array((BLOCK - (size % BLOCK)) % BLOCK);
}
