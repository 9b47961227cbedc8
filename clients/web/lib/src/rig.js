// The motion of a rig of three.js as poses of SMPL.
//
// With P the parent's world rotation at rest, R the bone's local rotation at rest and q its local rotation now,
// P q R^-1 P^-1 is its turn in the model's axes, whatever the axes of the bone. Along a chain these are
// D_parent^-1 D_bone with D = W now W_rest^-1 of world rotations W, which also holds across bones between two joints.
import { Quaternion, Vector3 } from "three";
import { HIPS, LEG, PARENTS, PELVIS, bonesOf } from "./humanoid.js";
import { writeRotationVector } from "./kinematics.js";

function topOf(node) {
  let top = node;
  while (top.parent && !top.parent.isScene) top = top.parent;
  return top;
}

const lengthOf = ([hip, knee, ankle]) => hip.distanceTo(knee) + knee.distanceTo(ankle);

export class RigSource {
  // rig: as bonesOf takes it, standing in its T-pose now. Its turns are told in the axes of frame, an Object3D around it
  // (the topmost below the scene if left out), turned so that it looks along z.
  constructor(rig, { names, frame } = {}) {
    this.bones = bonesOf(rig, names);
    this.object = rig.scene ?? rig;
    this.frame = frame ?? topOf(this.bones[PELVIS]);
    this.poses = new Float32Array(72);
    this.scale = 1;
    this.floorM = 0;
    this.facing = new Quaternion();
    const [left, right] = HIPS.map((joint) => this.#place(joint));
    const across = left.sub(right);
    this.facing.setFromAxisAngle(new Vector3(0, 1, 0), Math.atan2(across.z, across.x)); // its left along x
    this.restTurns = this.bones.map((bone, joint) => bone && this.#turn(joint).invert());
    this.restRoot = this.#place(PELVIS);
    this.legM = lengthOf(LEG.map((joint) => this.#place(joint)));
  }

  // Steps of the body that is draped, the service's or an avatar's, are as much longer as its legs are.
  async begin(drape, { betas, avatar } = {}) {
    const { joints, floor_m } = await drape.body(betas, avatar);
    this.floorM = floor_m;
    this.scale = lengthOf(LEG.map((joint) => new Vector3(...joints[joint]))) / this.legM;
  }

  // The pose that the rig stands in: 72 numbers, the same array each time, and the translation of the root [m].
  sample() {
    const turns = this.bones.map((bone, joint) => bone && this.#turn(joint).multiply(this.restTurns[joint]));
    const local = new Quaternion();
    for (let joint = 0; joint < PARENTS.length; joint++) {
      let above = PARENTS[joint];
      while (above >= 0 && !turns[above]) above = PARENTS[above];
      if (!turns[joint]) local.identity();
      else if (above < 0) local.copy(turns[joint]);
      else local.copy(turns[above]).invert().multiply(turns[joint]);
      writeRotationVector(local, this.poses, 3 * joint);
    }
    const way = this.#place(PELVIS).sub(this.restRoot).multiplyScalar(this.scale);
    return { poses: this.poses, trans: [way.x, way.y - this.floorM, way.z] };
  }

  // The rotation of a bone in the axes that look along z.
  #turn(joint) {
    const around = this.frame.getWorldQuaternion(new Quaternion()).invert();
    const turn = around.multiply(this.bones[joint].getWorldQuaternion(new Quaternion()));
    const { facing } = this;
    return turn.premultiply(facing).multiply(facing.clone().invert());
  }

  #place(joint) {
    const place = this.bones[joint].getWorldPosition(new Vector3());
    return this.frame.worldToLocal(place).applyQuaternion(this.facing);
  }
}

export const rigSource = (rig, choice) => new RigSource(rig, choice);
