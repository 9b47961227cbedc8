/** The script of a worker that decodes frames: see `Access.worker`. It exports nothing. */
export {};
