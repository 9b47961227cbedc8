import type { Drape } from "./index.js";

/** How long a garment takes on this machine. */
export interface Computing {
  /** The median time of the network's first frames [ms]. */
  warmMs: number;
}

export interface LocalAccess {
  /** Makes a module worker that imports "@drape/client/local-worker", where a page may have none from a blob. */
  worker?: () => Worker;
}

export interface LocalDrape extends Drape {
  /** Of the garment that was put on last; null before. */
  readonly computing: Promise<Computing> | null;
}

/** The folder that `python -m service.static` wrote, at an address; "./" if left out. */
export function openFolder(address?: string, access?: LocalAccess): Promise<LocalDrape>;
