// Poses of SMPL from key points of a person, one sample after the other. Points tell where joints are, and not how bones
// turn about themselves. So a pose is read in steps, each seen from the one before: the pelvis from hips and shoulders, the
// spine spread from there to the line of the shoulders, each limb by the least turn that lays its bone on the points, and its
// twist by the plane in which elbow or knee bends. What points cannot tell is zero: collars, wrists, hands, toes, a
// forearm's twist, and with COCO the feet.
import { JOINT_NAMES, PARENTS } from "./humanoid.js";
import { KeyPoints, checkLayout, checkedPoints, refuse } from "./key_points.js";
import { OneEuro } from "./one_euro.js";
import { ONE, across, cross, dot, leastTurn, length, less, ofVector, product, times, toVector, transposed, turned } from "./turns.js";

const JOINT = Object.fromEntries(JOINT_NAMES.map((name, joint) => [name, joint]));

const RADIANS = Math.PI / 180;
// Bends between which the twist of upper arm and thigh grows from zero to what they tell: a straight limb tells none, and the
// errors of its points are divided by the sine of the bend.
const TWIST_BENDS = [5 * RADIANS, 15 * RADIANS];
// Share of the hips' flexion by which the pelvis tilts back against the line from hips to shoulders. In 23 recorded clips
// (CMU) the spine bends forward by 0.43 of the flexion, with a correlation of 0.88. A fifth halves the pelvis's error there,
// from 16.9 to 8.8 degrees, and costs 1.7 in the sample clips, whose backs are straight.
const TUCK = 0.2;
const BACKWARDS = 0.5; // cosine beyond which a face looks backwards: nobody turns the head that far all the time
const TOLD_AFTER = 30; // pictures by which sides are judged
// Measured on the shipped body in the T-pose: from the middle of the ears the nose lies ahead and 14.4 degrees below, and
// from the heels the big toes lie ahead, inwards and below.
const LOOKING = ofVector([14.4 * RADIANS, 0, 0]);
const TOE_LINES = [[-0.114, -0.08, 0.99], [0.114, -0.08, 0.99]].map((line) => times(1 / length(line), line));

const HIPS = ["left_hip", "right_hip"];
const SHOULDERS = ["left_shoulder", "right_shoulder"];
const KNEES = ["left_knee", "right_knee"];
const TRUNK = [...HIPS, ...SHOULDERS];
const HEAD = ["left_ear", "right_ear", "nose"];
const SIDEWAYS = [1, 0, 0];
const LIMBS = [
  ["left_shoulder", "left_elbow", "left_wrist", [0, -1, 0]], ["right_shoulder", "right_elbow", "right_wrist", [0, 1, 0]],
  ["left_hip", "left_knee", "left_ankle", SIDEWAYS], ["right_hip", "right_knee", "right_ankle", SIDEWAYS],
].map(([upper, lower, end, flexion]) => ({ upper, lower, end, flexion }));

const shareOf = (rotation, share) => ofVector(times(share, toVector(rotation)));

// Frames of pelvis and chest: x along hips and along shoulders, y towards the line between the two.
function trunkFrames(points) {
  const all = points.withMiddles({ hips: HIPS, shoulders: SHOULDERS });
  const up = all.line("hips", "shoulders");
  return [["right_hip", "left_hip"], ["right_shoulder", "left_shoulder"]].map(([right, left]) => {
    const line = all.line(right, left);
    return all.frame(line, cross(line, up), TRUNK);
  });
}

// The twist [rad] about bone after which child hangs on its hinge, where it is childRest flexed about axis. A hinge keeps the
// child's part along its axis. Let v be the axis's part across the bone and u = v x bone: seen along the bone, the child lies
// at the angle phi from u to v, and belongs at phi_0, where
// (axis.bone) (child.bone) + |child's part across the bone| (axis.v) sin(phi_0) = axis.childRest.
function twistOf(child, bone, childRest, axis) {
  const aside = across(axis, bone);
  const v = times(1 / length(aside), aside);
  const [along, onU, onV] = [dot(child, bone), dot(child, cross(v, bone)), dot(child, v)];
  const far = Math.hypot(onU, onV);
  const sine = (dot(axis, childRest) - dot(axis, bone) * along) / Math.max(far * dot(axis, v), 1e-12);
  const angle = Math.atan2(onV, onU) - Math.asin(Math.min(Math.max(sine, -1), 1));
  const [low, high] = TWIST_BENDS;
  const told = Math.min(Math.max((Math.atan2(far, along) - low) / (high - low), 0), 1);
  // At half a turn either sign is right, and a blend jumps.
  return Math.atan2(Math.sin(angle), Math.cos(angle)) * told * told * (3 - 2 * told);
}

// The rotation of start onto end: about axis, then by the least turn.
function bent(end, start, axis) {
  const [from, to] = [across(start, axis), across(end, axis)];
  const hinged = ofVector(times(Math.atan2(dot(cross(from, to), axis), dot(from, to)), axis));
  return product(leastTurn(turned(hinged, start), end, hinged), hinged);
}

export class LandmarkPoses {
  // rest: places [m] of the 24 joints in the T-pose of the body that is posed.
  constructor(rest, { layout = "mediapipe" } = {}) {
    checkLayout(layout);
    this.layout = layout;
    this.joints = rest;
    const points = new KeyPoints(Object.fromEntries(JOINT_NAMES.map((name, at) => [name, { place: Array.from(rest[at]), seen: true }])), "rest");
    const [pelvis, chest] = trunkFrames(points);
    const upper = LIMBS.map((limb) => points.line(limb.upper, limb.lower));
    this.rest = { pelvis, chest, upper, lower: LIMBS.map((limb) => points.line(limb.lower, limb.end)) };
    this.local = JOINT_NAMES.map(() => ONE);
    this.world = JOINT_NAMES.map(() => ONE);
    this.twists = LIMBS.map(() => 0);
    this.tilt = 0;
    this.looked = [];
  }

  // The pose, 72 numbers [rad], of points that checkedPoints has checked. What is not seen holds its last pose.
  read(checked) {
    const sample = KeyPoints.of(checked, this.layout);
    this.#checkSides(sample);
    this.#readTrunk(sample);
    LIMBS.forEach((limb, at) => this.#readLimb(sample, limb, at));
    if (sample.has("left_toe")) {
      ["left", "right"].forEach((side, at) => {
        const [ankle, heel, toe] = ["ankle", "heel", "toe"].map((name) => `${side}_${name}`);
        const ahead = this.#seenFrom(ankle, sample.line(heel, toe));
        this.#turn(ankle, bent(ahead, TOE_LINES[at], SIDEWAYS), sample.sees(heel, toe));
      });
    }
    return this.local.flatMap(toVector);
  }

  // Places [m] of the joints in the last pose, the pelvis where it is at rest.
  places() {
    const found = [];
    PARENTS.forEach((parent, joint) => {
      const way = parent < 0 ? null : turned(this.world[parent], less(this.joints[joint], this.joints[parent]));
      found.push(parent < 0 ? Array.from(this.joints[joint]) : found[parent].map((number, axis) => number + way[axis]));
    });
    return found;
  }

  #below(joint) {
    const parent = PARENTS[JOINT[joint]];
    return parent < 0 ? ONE : this.world[parent];
  }

  #seenFrom(joint, direction) {
    return turned(transposed(this.#below(joint)), direction);
  }

  // Sets a joint's rotation relative to its parent; where it is not seen it stays as it was.
  #turn(joint, rotation, seen) {
    if (seen) this.local[JOINT[joint]] = rotation;
    this.world[JOINT[joint]] = product(this.#below(joint), this.local[JOINT[joint]]);
  }

  #readTrunk(points) {
    const { rest } = this;
    const [pelvis, chest] = trunkFrames(points);
    const seen = points.sees(...TRUNK);
    const upright = product(pelvis, transposed(rest.pelvis));
    const bends = HIPS.map((hip, at) => {
      const thigh = turned(transposed(upright), points.line(hip, KNEES[at]));
      const still = rest.upper[2 + at];
      return Math.max(Math.atan2(thigh[2], -thigh[1]) - Math.atan2(still[2], -still[1]), 0);
    });
    if (seen && points.sees(...KNEES)) this.tilt = (-TUCK * (bends[0] + bends[1])) / 2;
    this.#turn("pelvis", product(upright, ofVector(times(this.tilt, SIDEWAYS))), seen);
    const third = shareOf(product(transposed(this.#below("spine1")), chest, transposed(rest.chest)), 1 / 3);
    for (const joint of ["spine1", "spine2", "spine3"]) this.#turn(joint, third, seen);
    const head = points.withMiddles({ ears: HEAD.slice(0, 2) });
    const looking = product(head.frame(head.line("right_ear", "left_ear"), head.line("ears", "nose"), HEAD), transposed(LOOKING));
    const half = shareOf(product(transposed(this.#below("neck")), looking), 0.5);
    for (const joint of ["neck", "head"]) this.#turn(joint, half, points.sees(...HEAD));
    for (const joint of ["left_collar", "right_collar"]) this.#turn(joint, ONE, true);
  }

  #readLimb(points, { upper, lower, end, flexion }, at) {
    const [bone, child] = [this.rest.upper[at], this.rest.lower[at]];
    const [upperSeen, lowerSeen] = [points.sees(upper, lower), points.sees(lower, end)];
    const along = points.line(lower, end);
    const swing = leastTurn(bone, this.#seenFrom(upper, points.line(upper, lower)));
    const hangs = turned(transposed(swing), this.#seenFrom(upper, along));
    if (upperSeen && lowerSeen) this.twists[at] = twistOf(hangs, bone, child, flexion);
    this.#turn(upper, product(swing, ofVector(times(this.twists[at], bone))), upperSeen);
    this.#turn(lower, bent(this.#seenFrom(lower, along), child, flexion), lowerSeen);
  }

  // Refuses points whose nose has been behind the shoulders for a second or two: whoever looks back does so for less.
  #checkSides(points) {
    if (!points.sees(...HEAD, ...TRUNK)) return;
    const forward = [2, 5, 8].map((entry) => trunkFrames(points)[1][entry]);
    this.looked.push(dot(forward, points.withMiddles({ ears: HEAD.slice(0, 2) }).line("ears", "nose")));
    if (this.looked.length < TOLD_AFTER) return;
    const mean = this.looked.splice(0).reduce((a, b) => a + b) / TOLD_AFTER;
    if (mean >= -BACKWARDS) return;
    const cure = "Swap the points of left and right, as a mirrored picture needs, or name the layout.";
    refuse("landmarks", "a nose on the side that the shoulders face", "one behind them: left and right look swapped", cure);
  }
}

// Poses of whoever a tracker sees: shirt.follow(source), and source.put(points) with each picture.
export class LandmarkSource {
  // smoothing: numbers of the One Euro filter, or null for none.
  constructor({ layout = "mediapipe", smoothing = {} } = {}) {
    checkLayout(layout);
    this.layout = layout;
    this.filter = smoothing && new OneEuro(smoothing);
    this.poses = this.newest = null;
    this.lastS = -Infinity;
  }

  // The body that is draped, the service's or an avatar's, tells how long bones are.
  async begin(drape, { betas, avatar } = {}) {
    const { joints, floor_m: floorM } = await drape.body(betas, avatar);
    this.poses = new LandmarkPoses(joints, { layout: this.layout });
    this.floorM = floorM;
  }

  // The points of a picture taken at timeS [s]; one that is not newer than the last is passed over.
  put(points, visibility, timeS = performance.now() / 1000) {
    if (!this.poses || !(timeS > this.lastS)) return;
    const { places, seen } = checkedPoints(points, visibility, this.layout);
    const smooth = this.filter ? this.filter.filter(places, timeS - this.lastS, seen) : places;
    this.lastS = timeS;
    const poses = this.poses.read({ places: smooth, seen });
    const found = this.poses.places();
    const lowest = Math.min(...[JOINT.left_ankle, JOINT.right_ankle].map((ankle) => found[ankle][1] - this.poses.joints[ankle][1]));
    this.newest = { poses, trans: [0, -this.floorM - lowest, 0] }; // the lower foot stands: points tell no place
  }

  // The newest pose, null before the first.
  sample() {
    return this.newest;
  }
}

export const landmarkSource = (choice) => new LandmarkSource(choice);
