import type { Group, Mesh, Object3D, Object3DEventMap } from "three";
import type { Access, Controls, Drape as Core, DrapeError, DrapeOptions, PlayChoice, Pose, Source, SourceFunction, Motion, State, Stats, WearOptions } from "./core.js";

import type { FabricLook } from "./three.js";

export * from "./core.js";
export type { FabricLook } from "./three.js";

/** The events of `Worn`. */
export interface WornEvents extends Object3DEventMap {
  /** The meshes have moved to a new frame. */
  frame: object;
  /** The stream has a new state; `error` is the refusal behind "waiting" or "refused". */
  state: { state: State; error: DrapeError | null };
  /** The service computes folds from now on, since a frame took `tookS` here, longer than `allowedS` [s]. */
  folds: { by: "server"; tookS: number; allowedS: number };
  /** The service did not say where garments cover the skin, which stays as it is. */
  cover: { error: unknown };
}

/** Options of `Drape.wear`, with those of drawing. */
export interface ShownOptions extends WearOptions {
  /** Whether the service's body is shown below the garments. */
  body?: boolean;
  /** A CSS colour for each garment, the innermost first. */
  colours?: string[];
  /** Whether cloth is cheap to draw: without weave and sheen. */
  plain?: boolean;
  /**
   * Whether `follow` calls `cover` with the character whose rig it follows, if an avatar wears the garments; true if
   * left out.
   */
  cover?: boolean;
}

/**
 * Garments that are worn, as a group of three.js. Its axes are the world of the poses: metres, y up. Moving the group
 * moves all.
 */
export class Worn extends Group<WornEvents> implements Controls {
  /** A mesh for each garment, the innermost first. A material that you put on one stays. */
  readonly meshes: Mesh[];
  /** The outermost garment. */
  readonly mesh: Mesh;
  /** The service's body; null unless `body` was asked for. */
  readonly body: Group | null;
  /** The pose, 72 numbers [rad], that the shown frame answers; null before the first. */
  readonly bodyPose: ArrayLike<number> | null;
  /** The place of the body's root joint in the group [m]. */
  readonly root: number[];
  readonly stats: Stats;
  readonly state: State;
  readonly foldsBy: "server" | "client";
  pose(poses: Pose, trans?: ArrayLike<number>): boolean;
  rigPose(quaternions: ArrayLike<number> | ArrayLike<ArrayLike<number>>, place?: ArrayLike<number>): boolean;
  follow(source: SourceFunction | Source | null): Promise<void>;
  play(motion: string | Motion, choice?: PlayChoice): Promise<void>;
  stop(): void;
  /**
   * Draws the avatar's `skin`, an object of the scene, a little farther from the viewer where garments cover it, so
   * that it does not show through them; null: draws it as it was. Rejects where no avatar wears the garments.
   */
  cover(skin: Object3D | null): Promise<void>;
  /** Drapes the garments in another fabric and gives them its look. */
  fabric(name: DrapeOptions["fabric"]): Promise<void>;
  /** The look of each garment's fabric, the innermost first. */
  readonly looks: FabricLook[];
  /** Dyes the garment number `layer`, the innermost is 0, in a CSS colour. */
  colour(layer: number, colour: string): void;
  /** Draws cloth cheaply from now on, without weave and sheen, or fully. */
  setPlain(plain: boolean): void;
  set(options: DrapeOptions): Promise<void>;
  /** Ends the stream, leaves the scene and frees the memory of the graphics card. */
  dispose(): void;
}

/** A service whose garments are objects of three.js. */
export interface Drape extends Omit<Core, "wear"> {
  /** Puts on a garment, or several over each other, the innermost first, by their ids. Add the group to your scene. */
  wear(garments: string | string[], options?: ShownOptions): Promise<Worn>;
}

/** The service at an address, once it has answered. */
export function connect(url: string, access?: Access): Promise<Drape>;
