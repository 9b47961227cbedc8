import type { Access, DrapeError, ShownOptions, Worn } from "./index.js";

export interface GarmentOptions extends ShownOptions {
  /** The name of a motion that plays. */
  play?: string;
  access?: Access;
}

export function useGarment(
  url: string,
  garments: string | string[],
  options?: GarmentOptions,
): { garment: Worn | null; error: DrapeError | Error | null };
