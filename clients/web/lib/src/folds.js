// The compiled engine: loaded where a client makes folds, and not before.

// The module's bytes, compressed, as text, which build.mjs puts in: so it needs no address of its own, whoever bundles this.
/* global ENGINE_TEXT */
export async function compiled() {
  const packed = Uint8Array.from(atob(ENGINE_TEXT), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return WebAssembly.compile(await new Response(stream).arrayBuffer());
}
