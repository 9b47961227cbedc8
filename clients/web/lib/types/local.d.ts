import type { Drape } from "./index.js";

/** How fast a garment is draped on this machine. */
export interface Computing {
  /** The median time of the network's first frames [ms]. */
  warmMs: number;
}

/** How a folder is opened. */
export interface LocalAccess {
  /**
   * Returns a new module worker that imports "@drape/client/local-worker", for pages that may not start one from a
   * blob.
   */
  worker?: () => Worker;
}

/** A folder in place of a service. */
export interface LocalDrape extends Drape {
  /** The speed of the garment that was put on last, once it is known; null before `wear`. */
  readonly computing: Promise<Computing> | null;
}

/**
 * The folder at an address, "./" if left out, that `python -m service.static` wrote. It drapes on this page, without a
 * service.
 */
export function openFolder(address?: string, access?: LocalAccess): Promise<LocalDrape>;
