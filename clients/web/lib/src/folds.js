// The compiled step of folds: loaded where a client makes them, and not before.

// The module's bytes as text, which build.mjs puts in: so it needs no address of its own, whoever bundles this.
/* global FOLDS_TEXT */
export const compiled = async () => WebAssembly.compile(Uint8Array.from(atob(FOLDS_TEXT), (letter) => letter.charCodeAt(0)));
