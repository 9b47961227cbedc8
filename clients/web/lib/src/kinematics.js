// Where the joints of a pose are, and how they are turned: forward kinematics of SMPL's 24 joints.
import { Quaternion, Vector3 } from "three";
import { PARENTS } from "./humanoid.js";

const axis = new Vector3();

// The rotation of a rotation vector [rad], three numbers of pose from first on.
export function rotationOf(pose, first, target = new Quaternion()) {
  axis.fromArray(pose, first);
  const angle = axis.length();
  return target.setFromAxisAngle(angle > 1e-9 ? axis.divideScalar(angle) : axis.set(0, 1, 0), angle);
}

// The rotation vector [rad], in three numbers of target from first on, of a unit quaternion.
export function writeRotationVector({ x, y, z, w }, target, first) {
  const sine = Math.hypot(x, y, z);
  const angle = 2 * Math.atan2(sine, Math.abs(w)) * Math.sign(w || 1); // the shorter way round
  const scale = sine > 1e-12 ? angle / sine : 2;
  target[first] = scale * x;
  target[first + 1] = scale * y;
  target[first + 2] = scale * z;
}

// The turn of each joint in the world, from its T-pose on.
export function jointTurns(pose) {
  const turns = [];
  PARENTS.forEach((parent, joint) => {
    const own = rotationOf(pose, 3 * joint);
    turns.push(parent < 0 ? own : own.premultiply(turns[parent]));
  });
  return turns;
}

// Places [m] of the joints, x, y, z of each. root: that of the pelvis; rest: places at rest, of which the ways from joint to
// joint count.
export function jointPlaces(pose, root, rest) {
  const turns = jointTurns(pose);
  const places = [];
  PARENTS.forEach((parent, joint) => {
    if (parent < 0) places.push(new Vector3().fromArray(root));
    else places.push(new Vector3().subVectors(new Vector3(...rest[joint]), new Vector3(...rest[parent])).applyQuaternion(turns[parent]).add(places[parent]));
  });
  return places.map((place) => place.toArray());
}
