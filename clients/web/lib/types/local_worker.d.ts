/** The script of a worker that drapes without a service: see `LocalAccess.worker`. It exports nothing. */
export {};
