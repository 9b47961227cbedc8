// The motion of a body as the network reads it. A copy of drape/body/features.py and service/stages/motion.py for browsers.
import { PARENTS } from "./humanoid.js";
import { length, less, ofVector, product, times, transposed, turned } from "./turns.js";

const STEP_LIMIT_S = 0.25; // after a longer pause the cloth hangs still again
const SHORTEST_STEP_S = 1 / 240; // frames that come closer together count as this far apart
const JUMP_M_S = 25; // a joint that is faster was not moved there
const STILL = 1e-6; // smaller descriptors are rounding
const SIXD = [0, 3, 6, 1, 4, 7];
const NEUTRAL = [1, 0, 0, 0, 1, 0]; // the root's own turn is not told

// Static descriptors, 9 numbers a joint, places [m] and rotations of the joints. pose: 72 numbers [rad]; trans: of the root
// [m]; rest: places of the joints at rest.
export function kinematicsOf(pose, trans, rest) {
  const rotations = [];
  const joints = [];
  const descriptors = PARENTS.map((parent, joint) => {
    const own = ofVector(Array.from(pose.slice(3 * joint, 3 * joint + 3)));
    const above = parent < 0 ? null : rotations[parent];
    const world = above ? product(above, own) : own;
    const start = above ? joints[parent] : rest[0].map((x, a) => x + trans[a]);
    const way = above ? turned(above, less(rest[joint], rest[parent])) : [0, 0, 0];
    rotations.push(world);
    joints.push(start.map((x, a) => x + way[a]));
    const sixd = above ? SIXD.map((entry) => own[entry]) : NEUTRAL;
    return [...sixd, -world[3], -world[4], -world[5]]; // and where gravity points in the joint's frame
  });
  return { descriptors, joints, rotations };
}

// Dynamic descriptors, 12 numbers a joint, of moments { timeS, descriptors, joints, rotations }.
export function motionFeatures(now, before, earlier, dtS, dtBeforeS) {
  return Float32Array.from(
    now.descriptors.flatMap((numbers, joint) => {
      const rates = numbers.map((number, i) => (number - before.descriptors[joint][i]) / dtS);
      const speed = times(1 / dtS, less(now.joints[joint], before.joints[joint]));
      const speedBefore = times(1 / dtBeforeS, less(before.joints[joint], earlier.joints[joint]));
      const acceleration = times(2 / (dtS + dtBeforeS), less(speed, speedBefore));
      return [...rates, ...turned(transposed(now.rotations[joint]), acceleration)];
    }),
    (number) => (Math.abs(number) < STILL ? 0 : number),
  );
}

export class Motion {
  // rest: places [m] of the joints at rest; advance(features, state, dtS) promises { code, state }, whose sizes are given.
  constructor(rest, { code, state }, advance) {
    this.rest = rest;
    this.advance = advance;
    this.sizes = { code, state };
    this.#begin([]);
  }

  #begin(moments) {
    this.moments = moments; // the newest first
    this.code = new Float32Array(this.sizes.code);
    this.state = new Float32Array(this.sizes.state);
  }

  // Promises the code of the next moment.
  async next(pose, trans, timeS) {
    const moment = { timeS, ...kinematicsOf(pose, trans, this.rest) };
    const [last] = this.moments;
    const dtS = last ? timeS - last.timeS : -1;
    if (dtS === 0) return this.code;
    if (dtS > 0 && dtS <= STEP_LIMIT_S && !this.#jumps(moment, last, dtS)) this.moments = [moment, ...this.moments];
    else this.#begin([moment]);
    if (this.moments.length === 3) {
      const [now, before, earlier] = this.moments;
      const [step, stepBefore] = [[now, before], [before, earlier]].map(([newer, older]) => Math.max(newer.timeS - older.timeS, SHORTEST_STEP_S));
      const after = await this.advance(motionFeatures(now, before, earlier, step, stepBefore), this.state, step);
      Object.assign(this, { moments: [now, before], ...after });
    }
    return this.code;
  }

  #jumps(moment, last, dtS) {
    const furthest = Math.max(...moment.joints.map((place, joint) => length(less(place, last.joints[joint]))));
    return furthest / Math.max(dtS, SHORTEST_STEP_S) > JUMP_M_S;
  }

  // The body has not moved, and is as old as it was at the time [s].
  rested(timeS) {
    const laterS = timeS - (this.moments[0]?.timeS ?? timeS);
    for (const moment of this.moments) moment.timeS += laterS;
  }
}
