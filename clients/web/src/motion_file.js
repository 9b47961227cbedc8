// Motions of files, as the service reads them: the npz that it answers, and the clip on the ground for a body.
import { clipSource } from "../lib/src/sources.js";
import { LEG } from "../lib/src/humanoid.js";
import { jointPlaces } from "../lib/src/kinematics.js";

const SOLES = [7, 8, 10, 11]; // ankles and toes
const LEG_M = 0.78; // of whom the service tells motions for
const NUMBERS = 72;

// { fps, poses, trans } of a motion file, of the animation called clip in it or of its longest.
export async function askMotion(rest, file, clip = null) {
  const query = new URLSearchParams({ name: file.name.slice(-120), ...(clip === null ? {} : { clip }) });
  const headers = { "Content-Type": "application/octet-stream" };
  const answer = await rest.request(`/motions?${query}`, { method: "POST", headers, body: file });
  const { poses, trans, mocap_framerate: rate } = await unzipped(await answer.arrayBuffer());
  const rows = (numbers, width) => Array.from({ length: numbers.length / width }, (_, k) => numbers.subarray(k * width, (k + 1) * width));
  return { fps: rate[0], poses: rows(poses, NUMBERS), trans: rows(trans, 3) };
}

const lengthOf = (joints, [hip, knee, ankle]) => distance(joints[hip], joints[knee]) + distance(joints[knee], joints[ankle]);
const distance = (a, b) => Math.hypot(...a.map((one, k) => one - b[k]));

// A clip for body { joints, floor_m }: its steps are as much longer as the legs are, it begins in the middle, and the
// lowest sole of all frames stands on the floor.
export function placed({ fps, poses, trans }, { joints, floor_m }) {
  const scale = lengthOf(joints, LEG) / LEG_M;
  const ways = trans.map((place) => place.map((one, k) => scale * (one - (k === 1 ? 0 : trans[0][k]))));
  let lowest = Infinity;
  poses.forEach((pose, frame) => {
    const root = joints[0].map((rest, k) => rest + ways[frame][k]);
    const places = jointPlaces(pose, root, joints);
    for (const joint of SOLES) lowest = Math.min(lowest, places[joint][1] - (joints[joint][1] - floor_m));
  });
  for (const way of ways) way[1] -= lowest;
  const clip = { fps, frames: poses.length, poses, trans: ways };
  return { ...clip, sample: clipSource(clip) };
}

// The numbers of the arrays in an npz, by name: a zip of npy files, deflated.
async function unzipped(bytes) {
  const view = new DataView(bytes);
  let end = bytes.byteLength - 22;
  while (view.getUint32(end, true) !== 0x06054b50) end -= 1;
  const arrays = {};
  let at = view.getUint32(end + 16, true);
  for (let left = view.getUint16(end + 10, true); left > 0; left--) {
    const length = view.getUint16(at + 28, true);
    const name = new TextDecoder().decode(new Uint8Array(bytes, at + 46, length));
    const local = view.getUint32(at + 42, true);
    const start = local + 30 + view.getUint16(local + 26, true) + view.getUint16(local + 28, true);
    const packed = new Blob([new Uint8Array(bytes, start, view.getUint32(at + 20, true))]);
    const npy = await new Response(packed.stream().pipeThrough(new DecompressionStream("deflate-raw"))).arrayBuffer();
    const numbers = 10 + new DataView(npy).getUint16(8, true);
    if (/'descr': '<f4'/.test(new TextDecoder().decode(npy.slice(10, numbers)))) arrays[name.replace(/\.npy$/, "")] = new Float32Array(npy.slice(numbers));
    at += 46 + length + view.getUint16(at + 30, true) + view.getUint16(at + 32, true);
  }
  return arrays;
}
