import type { Bone, Group, Material, Object3D, SkinnedMesh } from "three";
import type { Drape, Sample, Source, WearOptions } from "./core.js";

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
  constructor(rig: Object3D | Humanoid, choice?: RigChoice);
  begin(drape: Pick<Drape, "body">, options?: WearOptions): Promise<void>;
  sample(): { poses: Float32Array; trans: number[] } & Sample;
}

export function rigSource(rig: Object3D | Humanoid, choice?: RigChoice): RigSource;
export function poseBones(bones: Bone[], pose: ArrayLike<number>, root: ArrayLike<number>): void;
export function readBody(glb: ArrayBuffer, material?: Material): Promise<{ group: Group; mesh: SkinnedMesh; bones: Bone[] }>;
