// A hash of a list of words, since `crypto.subtle` is missing on pages without HTTPS.

const SEEDS = [0x811c9dc5, 0x1b873593];
const PRIME = 0x01000193;

/** Return the 64-bit FNV-1a hash of words, as hexadecimal digits. Collisions are possible but unlikely. */
export function fingerprint(words: string[]): string {
  const bytes = new TextEncoder().encode(words.map((word) => `${word.length} ${word}`).join("\n"));
  return SEEDS.map((seed) => {
    const hash = bytes.reduce((sum, byte) => Math.imul(sum ^ byte, PRIME), seed);
    return (hash >>> 0).toString(16).padStart(8, "0");
  }).join("");
}
