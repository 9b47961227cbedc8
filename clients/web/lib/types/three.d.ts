import type { Bone, Group, Material, Object3D, SkinnedMesh } from "three";
import type { AvatarInfo, Drape, FabricInfo, Layer, Sample, Source, WearOptions } from "./core.js";

/** The part of three-vrm's VRM that is needed here. */
export interface Humanoid {
  humanoid: { getRawBoneNode(name: never): Object3D | null };
}

/** How a rig is read. */
export interface RigChoice {
  /** The names of the rig's bones, by VRM's names of joints, for rigs with other names. */
  names?: Record<string, string>;
  /** The object in whose axes poses are measured; the rig's topmost ancestor below the scene if left out. */
  frame?: Object3D;
}

/** A source of the poses in which a rig stands. Construct it while the rig is in its T-pose. */
export class RigSource implements Source {
  /** The character, whose skin `Worn.cover` treats. */
  readonly object: Object3D;
  constructor(rig: Object3D | Humanoid, choice?: RigChoice);
  /** Fits the length of steps to the legs of the body that is draped. */
  begin(drape: Pick<Drape, "body">, options?: WearOptions): Promise<void>;
  /** The pose now: 72 numbers [rad], the same array each time, and the translation of the root [m]. */
  sample(): { poses: Float32Array; trans: number[] } & Sample;
}

/** The same as `new RigSource(rig, choice)`. */
export function rigSource(rig: Object3D | Humanoid, choice?: RigChoice): RigSource;
/** Turns each bone by its rotation vector [rad], 3 numbers of `pose`, and puts the first bone at `root` [m]. */
export function poseBones(bones: Bone[], pose: ArrayLike<number>, root: ArrayLike<number>): void;
/**
 * The service's body in the bytes of its BODY message: a group, its skinned mesh, its 24 bones, and their places at
 * rest [m].
 */
export function readBody(message: ArrayBuffer, material?: Material): { group: Group; mesh: SkinnedMesh; bones: Bone[]; rest: number[][] };

/** The look of a fabric; every number follows from the fabric's own. Numbers without a unit are 0 to 1. */
export interface FabricLook {
  bond: "plain" | "twill" | "satin" | "jersey" | "rib" | "fleece";
  /** Knitted, not woven. */
  knit: boolean;
  thicknessM: number;
  /** The distance between two yarns [m]. */
  pitchM: number;
  roughness: number;
  sheen: number;
  sheenRoughness: number;
  /** The depth of the furrows between yarns. */
  relief: number;
  /** How much highlights stretch along the warp. */
  grain: number;
  /** How much the shade varies over centimetres. */
  uneven: number;
  /** How much lighter than the warp the weft is, as in denim. */
  pale: number;
  opacity: number;
}

/** How a material of cloth is made. */
export interface ClothChoice {
  /** A CSS colour. */
  colour: string;
  /** How many metres a unit of the texture coordinates is, which gives the weave its true size; null: no weave. */
  uvMetres?: number | null;
  /** Whether seams and hems are drawn; the geometry then needs an attribute "border" of `borderDistances`. */
  bordered?: boolean;
  /** Whether cloth is cheap to draw: without weave and sheen. */
  plain?: boolean;
  /** How much nearer to the viewer than it is its outside is drawn [m], for garments worn over others. */
  nearerM?: number;
}

/** The look of a fabric of `Drape.fabrics`, or of one with such numbers; nothing: a jersey. */
export function fabricLook(fabric?: Partial<FabricInfo> | null): FabricLook;
/** A material of cloth with this look. */
export function clothMaterial(look: FabricLook, choice: ClothChoice): Material;
/** Gives a material a CSS colour, and its sheen a paler one; returns the same material. */
export function dye<T extends Material>(material: T, colour: string): T;
/**
 * The RGBA bytes of a square picture of the fabric, `size` pixels wide, as ImageData takes them; `yarns`, 12 if left
 * out, lie side by side.
 */
export function fabricSwatch(look: FabricLook, colour: string, size: number, yarns?: number): Uint8ClampedArray<ArrayBuffer>;
/** A material of skin; `tone` is a CSS colour. */
export function skinMaterial(tone?: string, choice?: { plain?: boolean }): Material;
/**
 * Two numbers for each vertex of a layer with texture coordinates, copies included: its distances [m] to the nearest
 * hem and to the nearest seam, at most 0.06.
 */
export function borderDistances(layer: Layer): Float32Array;

/** A user's character that can stand in SMPL poses. */
export interface Character {
  /** It, for your scene, in metres. */
  object: Object3D;
  /** The places of SMPL's 24 joints at rest [m]. */
  rest: [number, number, number][];
  /** Poses it: `pose` is 72 numbers [rad], `root` the place of the root joint [m]. */
  pose(pose: ArrayLike<number>, root: ArrayLike<number>): void;
}
/** The character in the bytes of a GLB or VRM that the service knows as `avatar`. */
export function readCharacter(bytes: ArrayBuffer, avatar: AvatarInfo): Promise<Character>;
