/** The engine that makes folds, compiled; rejects where a page may not compile, or without vector instructions. */
export function compiled(): Promise<WebAssembly.Module>;
