// How unlike the poses of training a pose is. A copy of drape/body/pose_distance.py for browsers.
import { JOINT_NAMES } from "./humanoid.js";
import { ofVector } from "./turns.js";

const FIRST_COLUMNS = [0, 3, 6, 1, 4, 7]; // entries of a rotation, row after row
const UP = [3, 4, 5];
const STEPS = 127; // of a stored number
const BODY_JOINTS = JOINT_NAMES.map((_, joint) => joint).slice(1, 22); // without the root and the hands
const LEGS = BODY_JOINTS.filter((joint) => /_(hip|knee|ankle|foot)$/.test(JOINT_NAMES[joint]));
const TRUNK = BODY_JOINTS.filter((joint) => !LEGS.includes(joint));
const ENTRIES = [...[LEGS, TRUNK].map((joints) => joints.flatMap((joint) => FIRST_COLUMNS.map((i) => [joint, i]))), UP.map((i) => [0, i])];

export class PoseSupport {
  // kept: poses in steps, row after row of each part; rows: their number; limits: how far from the nearest is unlike.
  constructor(kept, { rows, limits }) {
    const steps = new Int8Array(kept);
    let from = 0;
    this.parts = rows.map((count, part) => {
      const width = ENTRIES[part].length;
      const numbers = Float32Array.from(steps.subarray(from, (from += count * width)), (step) => step / STEPS);
      return { entries: ENTRIES[part], numbers, width, limit: limits[part], joints: Math.max(1, Math.floor(width / FIRST_COLUMNS.length)) };
    });
  }

  // Of a pose of 72 numbers [rad]: above 1 it is unlike.
  novelty(pose) {
    const turns = JOINT_NAMES.map((_, joint) => ofVector(Array.from(pose.slice(3 * joint, 3 * joint + 3))));
    return Math.max(...this.parts.map(({ entries, numbers, width, limit, joints }) => {
      const row = entries.map(([joint, i]) => turns[joint][i]);
      let least = Infinity;
      for (let at = 0; at < numbers.length; at += width) {
        let square = 0;
        for (let i = 0; i < width; i++) square += (row[i] - numbers[at + i]) ** 2;
        least = Math.min(least, square);
      }
      return Math.sqrt(least / joints) / limit;
    }));
  }
}
