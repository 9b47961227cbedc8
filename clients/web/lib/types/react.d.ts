import type { Access, DrapeError, ShownOptions, Worn } from "./index.js";

type FrameEvent = { type: "frame"; target: Worn };

/** Options of `useGarment` and `Garment`. */
export interface GarmentOptions extends ShownOptions {
  /** The id of a motion that plays. */
  play?: string;
  /** As `connect` takes it. */
  access?: Access;
}

/**
 * Wears garments of the service at `url` for as long as the component is mounted. `garment` is null until it is worn:
 * `<primitive object={garment} />`.
 */
export function useGarment(
  url: string,
  garments: string | string[],
  options?: GarmentOptions,
): { garment: Worn | null; error: DrapeError | Error | null };

/**
 * Garments of the service at the address `service`, within the Canvas of React Three Fiber. `onFrame` is called when a
 * frame is shown. An error is thrown to the nearest error boundary.
 */
export function Garment(
  props: GarmentOptions & { service: string; garments: string | string[]; onFrame?: (event: FrameEvent) => void },
): any;
