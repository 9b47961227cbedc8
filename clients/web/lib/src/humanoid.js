// Joints of SMPL by the names that rigs give them: VRM's humanoid bones and Mixamo's.
import { DrapeError } from "./errors.js";

// SMPL's 24 joints and their parents, in the order of the wire (drape/body/skeleton.py).
export const JOINT_NAMES = [
  "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle", "spine3",
  "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow",
  "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
];
export const PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21];
export const PELVIS = 0;
export const HIPS = [1, 2]; // left, right
export const LEG = [1, 4, 7]; // hip, knee, ankle of the left one

// [VRM, Mixamo] by joint; the last two, SMPL's hands, are fingers of such rigs and stay as they are.
const NAMES = [
  ["hips", "Hips"], ["leftUpperLeg", "LeftUpLeg"], ["rightUpperLeg", "RightUpLeg"], ["spine", "Spine"],
  ["leftLowerLeg", "LeftLeg"], ["rightLowerLeg", "RightLeg"], ["chest", "Spine1"], ["leftFoot", "LeftFoot"],
  ["rightFoot", "RightFoot"], ["upperChest", "Spine2"], ["leftToes", "LeftToeBase"], ["rightToes", "RightToeBase"],
  ["neck", "Neck"], ["leftShoulder", "LeftShoulder"], ["rightShoulder", "RightShoulder"], ["head", "Head"],
  ["leftUpperArm", "LeftArm"], ["rightUpperArm", "RightArm"], ["leftLowerArm", "LeftForeArm"],
  ["rightLowerArm", "RightForeArm"], ["leftHand", "LeftHand"], ["rightHand", "RightHand"],
];
// Without these a body is no body; rigs may lack the others (VRM asks for no neck, chest, shoulders or toes).
const NEEDED = [0, 1, 2, 4, 5, 7, 8, 16, 17, 18, 19];

const plain = (name) => name.replace(/^mixamorig\d*:?/, "");

// The bone of each joint, or null. rig: a VRM (of three-vrm), or an Object3D with bones below it; names: { joint's VRM
// name: name of a bone } for rigs that name theirs otherwise.
export function bonesOf(rig, names = {}) {
  const found = new Map();
  const nodes = rig.isSkinnedMesh ? rig.skeleton.bones : [];
  if (rig.isObject3D && !nodes.length) rig.traverse((node) => nodes.push(node));
  for (const node of nodes) {
    if (!found.has(node.name)) found.set(node.name, node);
    if (!found.has(plain(node.name))) found.set(plain(node.name), node);
  }
  const bones = NAMES.map(([vrm, mixamo]) => {
    if (names[vrm]) return found.get(names[vrm]) ?? null;
    return rig.humanoid?.getRawBoneNode(vrm) ?? found.get(vrm) ?? found.get(mixamo) ?? null;
  });
  const missing = NEEDED.filter((joint) => !bones[joint]).map((joint) => NAMES[joint][0]);
  if (!missing.length) return bones;
  throw new DrapeError({
    name: "rig",
    expected: "a humanoid whose bones have VRM's or Mixamo's names",
    got: `one without ${missing.join(", ")}`,
    cure: "Name its bones: rigSource(rig, { names: { hips: \"Pelvis\", ... } }).",
    kind: "InputError",
  });
}
