import type { Bone, Group, Material, Object3D, SkinnedMesh } from "three";
import type { AvatarInfo, Drape, FabricInfo, Layer, Sample, Source, WearOptions } from "./core.js";

/** A VRM of three-vrm, as far as it is needed here. */
export interface Humanoid {
  humanoid: { getRawBoneNode(name: never): Object3D | null };
}

export interface RigChoice {
  /** Names of bones by VRM's names of joints, for rigs that name theirs otherwise. */
  names?: Record<string, string>;
  /** The object in whose axes the rig stands; the topmost below the scene if left out. */
  frame?: Object3D;
}

/** Poses of a rig; make it while the rig stands in its T-pose. */
export class RigSource implements Source {
  /** What follows it covers the skin below this. */
  readonly object: Object3D;
  constructor(rig: Object3D | Humanoid, choice?: RigChoice);
  begin(drape: Pick<Drape, "body">, options?: WearOptions): Promise<void>;
  sample(): { poses: Float32Array; trans: number[] } & Sample;
}

export function rigSource(rig: Object3D | Humanoid, choice?: RigChoice): RigSource;
export function poseBones(bones: Bone[], pose: ArrayLike<number>, root: ArrayLike<number>): void;
export function readBody(message: ArrayBuffer, material?: Material): { group: Group; mesh: SkinnedMesh; bones: Bone[]; rest: number[][] };

/** How a fabric looks; every number follows from what the service tells of it. */
export interface FabricLook {
  bond: "plain" | "twill" | "satin" | "jersey" | "rib" | "fleece";
  knit: boolean;
  thicknessM: number;
  /** Between two yarns [m]. */
  pitchM: number;
  roughness: number;
  sheen: number;
  sheenRoughness: number;
  /** How deep its yarns lie; how much light runs along the warp; how much its shade varies over centimetres. */
  relief: number;
  grain: number;
  uneven: number;
  /** How much lighter the weft is, as of denim. */
  pale: number;
  opacity: number;
}

export interface ClothChoice {
  /** As CSS writes it. */
  colour: string;
  /** Metres of a unit of the texture coordinates: its weave then has its true size. */
  uvMetres?: number | null;
  /** Whether the geometry has the attribute "border" of borderDistances(): seams and hems are drawn. */
  bordered?: boolean;
  plain?: boolean;
  /** How much nearer to the viewer its outside is drawn than it is, as of what is worn over something else [m]. */
  nearerM?: number;
}

export function fabricLook(fabric?: Partial<FabricInfo> | null): FabricLook;
export function clothMaterial(look: FabricLook, choice: ClothChoice): Material;
export function dye<T extends Material>(material: T, colour: string): T;
/** RGBA of a swatch, as ImageData takes them; yarns: how many across. */
export function fabricSwatch(look: FabricLook, colour: string, size: number, yarns?: number): Uint8ClampedArray<ArrayBuffer>;
export function skinMaterial(tone?: string, choice?: { plain?: boolean }): Material;
/** Of each vertex, copies included, its distance [m] to the nearest hem and to the nearest seam, 0.06 at most. */
export function borderDistances(layer: Layer): Float32Array;

/** A character of the user's that stands in poses of ours. */
export interface Character {
  object: Object3D;
  /** Places [m] of the joints at rest. */
  rest: [number, number, number][];
  pose(pose: ArrayLike<number>, root: ArrayLike<number>): void;
}
export function readCharacter(bytes: ArrayBuffer, avatar: AvatarInfo): Promise<Character>;
