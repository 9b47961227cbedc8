import type { Access, DrapeError, ShownOptions, Worn } from "./index.js";

type FrameEvent = { type: "frame"; target: Worn };

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

/** Within the Canvas of React Three Fiber: a garment of the service at an address. Its error is thrown to an error boundary. */
export function Garment(
  props: GarmentOptions & { service: string; garments: string | string[]; onFrame?: (event: FrameEvent) => void },
): any;
