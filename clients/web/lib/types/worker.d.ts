// The script of a worker: it is imported there, once, and has nothing to call.
export {};
