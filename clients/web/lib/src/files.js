// Files of a folder that lies on any server, compressed or as they are.
import { DrapeError } from "./errors.js";

// A function that promises the bytes of a file in the folder at an address, decompressed.
export const filesOf = (base) => async (name) => {
  const answer = await fetch(new URL(name, base)).catch(() => null);
  if (!answer?.ok) {
    const got = answer ? `${answer.status} ${answer.statusText}` : "no answer";
    throw new DrapeError({ name, expected: `a file in ${base}`, got, cure: "Copy the whole folder.", kind: "NotFound" });
  }
  const bytes = await answer.arrayBuffer();
  const [first, second] = new Uint8Array(bytes, 0, 2);
  if (first !== 0x1f || second !== 0x8b) return bytes; // some servers decompress what ends in .gz
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
};
