/** A worker that drapes without a service: see `LocalAccess.worker`. */
export {};
