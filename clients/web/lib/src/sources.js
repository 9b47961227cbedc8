// Where poses come from, frame by frame: a clip, or what a caller follows.
import { DrapeError } from "./errors.js";

const NUMBERS = 72;
const RATE_HZ = 60; // poses a second at most; a service drops what is more
const PAUSE_MS = 1000 / RATE_HZ;
const EARLY_MS = 2; // pictures come a little early or late

// The 72 numbers of rotation vectors that came as such or as 24 triples.
export function flatPose(poses) {
  const flat = poses.length === NUMBERS ? poses : Array.from(poses, (joint) => Array.from(joint)).flat();
  if (flat.length === NUMBERS) return flat;
  throw new DrapeError({
    name: "poses",
    expected: `24 rotation vectors, or their ${NUMBERS} numbers`,
    got: `${flat.length} numbers`,
    cure: "Give one frame at a time.",
    kind: "MotionError",
  });
}

// A source that plays the document of GET /motions/{id}; speed: 1 as recorded; loop: from the end to the beginning.
export function clipSource(clip, { speed = 1, loop = true } = {}) {
  const poses = clip.poses.map(flatPose);
  return (timeS) => {
    const frame = Math.floor(timeS * speed * clip.fps);
    const at = loop ? ((frame % clip.frames) + clip.frames) % clip.frames : Math.min(Math.max(frame, 0), clip.frames - 1);
    return { poses: poses[at], trans: clip.trans[at] };
  };
}

// Calls task(timeS), seconds since now, with the pictures of a page, or as often without one; returns what ends it.
export function everyPicture(task) {
  const drawn = typeof requestAnimationFrame === "function";
  const later = drawn ? requestAnimationFrame : (next) => setTimeout(next, PAUSE_MS);
  const begun = performance.now();
  let last = -Infinity;
  let handle;
  const step = () => {
    handle = later(step);
    const now = performance.now();
    if (now - last < PAUSE_MS - EARLY_MS) return;
    last = now;
    task((now - begun) / 1000);
  };
  handle = later(step);
  return () => (drawn ? cancelAnimationFrame(handle) : clearTimeout(handle));
}
