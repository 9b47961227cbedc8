import type { Group, Mesh, Object3D, Object3DEventMap } from "three";
import type { Access, Controls, Drape as Core, DrapeError, DrapeOptions, PlayChoice, Pose, Source, SourceFunction, Motion, State, Stats, WearOptions } from "./core.js";

import type { FabricLook } from "./three.js";

export * from "./core.js";
export type { FabricLook } from "./three.js";

export interface WornEvents extends Object3DEventMap {
  frame: object;
  state: { state: State; error: DrapeError | null };
  /** The service makes the folds from now on: here a frame took longer than it may [s]. */
  folds: { by: "server"; tookS: number; allowedS: number };
  /** What lies under the garments was not found out; the skin is drawn as it is. */
  cover: { error: unknown };
}

export interface ShownOptions extends WearOptions {
  /** Shows the service's body below the garments. */
  body?: boolean;
  /** One for each garment, as CSS writes it. */
  colours?: string[];
  /** Cloth that is cheap to draw, without weave and sheen. */
  plain?: boolean;
  /** Whether the skin of a rig that it follows is drawn deeper where it lies under it, of an avatar; true if left out. */
  cover?: boolean;
}

/** What is worn, in a scene. Within it the axes are those of the poses, y up; moving the group moves all. */
export class Worn extends Group<WornEvents> implements Controls {
  /** One for each garment, the innermost first; their materials are yours to change. */
  readonly meshes: Mesh[];
  /** The outermost garment. */
  readonly mesh: Mesh;
  readonly body: Group | null;
  /** The pose that the shown frame answers; null before the first. */
  readonly bodyPose: ArrayLike<number> | null;
  /** Where the body's root is in it [m]. */
  readonly root: number[];
  readonly stats: Stats;
  readonly state: State;
  readonly foldsBy: "server" | "client";
  pose(poses: Pose, trans?: ArrayLike<number>): boolean;
  /** One pose of the avatar's own rig: x, y, z, w of each of its nodes, and where that of its pelvis is [m]. */
  rigPose(quaternions: ArrayLike<number> | ArrayLike<ArrayLike<number>>, place?: ArrayLike<number>): boolean;
  follow(source: SourceFunction | Source | null): Promise<void>;
  play(motion: string | Motion, choice?: PlayChoice): Promise<void>;
  stop(): void;
  /** Draws the avatar's skin, an object of the scene, a little deeper where garments cover it; null: as it was. */
  cover(skin: Object3D | null): Promise<void>;
  /** Drapes it of another fabric, and gives it that fabric's look. */
  fabric(name: DrapeOptions["fabric"]): Promise<void>;
  /** How each garment looks, by its fabric, the innermost first. */
  readonly looks: FabricLook[];
  /** Dyes a garment, as CSS writes colours; the innermost is 0. */
  colour(layer: number, colour: string): void;
  /** From now on cheap to draw, or not. */
  setPlain(plain: boolean): void;
  set(options: DrapeOptions): Promise<void>;
  dispose(): void;
}

export interface Drape extends Omit<Core, "wear"> {
  wear(garments: string | string[], options?: ShownOptions): Promise<Worn>;
}

export function connect(url: string, access?: Access): Promise<Drape>;
