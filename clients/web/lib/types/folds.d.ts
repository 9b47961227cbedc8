/**
 * The engine that computes folds, compiled. Rejects where a page may not compile WebAssembly, or the browser has no
 * vector instructions.
 */
export function compiled(): Promise<WebAssembly.Module>;
