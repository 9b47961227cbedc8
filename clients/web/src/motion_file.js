// Motions from files that are dropped: BVH by three.js and the library's rigs, AMASS and our own npz.
import { Euler, Group, Quaternion } from "three";
import { BVHLoader } from "three/addons/loaders/BVHLoader.js";
import { jointPlaces, rotationOf, writeRotationVector } from "../lib/src/kinematics.js";
import { rigSource } from "../lib/src/rig.js";

const JOINTS = 24;
const HANDS_FROM = 66; // of an AMASS pose: what follows are fingers
const SOLES = [7, 8, 10, 11]; // ankles and toes
const MOST_FRAMES = 20_000;

const refused = (file, expected, got) => new Error(`${file}: expected ${expected}, got ${got}.`);

// { name, fps, frames, poses, trans }, on the ground for body: { joints, floor_m }. drape and options: for whom it is.
export async function readMotion(file, drape, options) {
  const body = await drape.body(options.betas, options.avatar ?? null);
  const clip = /\.npz$/i.test(file.name) ? await readNpz(file) : await readBvh(file, drape, options);
  clip.poses = clip.poses.slice(0, MOST_FRAMES);
  ground(clip, body);
  return { name: file.name.replace(/\.\w+$/, ""), frames: clip.poses.length, ...clip };
}

// Moves it so that the lowest sole of all frames stands on the floor and it begins in the middle.
function ground({ poses, trans }, { joints, floor_m }) {
  const [x, , z] = trans[0];
  let lowest = Infinity;
  poses.forEach((pose, frame) => {
    const root = joints[0].map((rest, k) => rest + trans[frame][k]);
    const places = jointPlaces(pose, root, joints);
    for (const joint of SOLES) lowest = Math.min(lowest, places[joint][1] - (joints[joint][1] - floor_m));
  });
  for (const place of trans) {
    place[0] -= x;
    place[1] -= lowest;
    place[2] -= z;
  }
}

async function readBvh(file, drape, options) {
  const { clip, skeleton } = new BVHLoader().parse(await file.text());
  const times = clip.tracks[0]?.times ?? [];
  if (times.length < 1 || !skeleton.bones.length) throw refused(file.name, "a skeleton and its frames", "none");
  const group = new Group();
  group.add(skeleton.bones[0]);
  group.updateMatrixWorld(true);
  const source = rigSource(group);
  await source.begin(drape, options);
  const tracks = new Map(clip.tracks.map(({ name, values }) => [name, values]));
  const poses = [];
  const trans = [];
  for (let frame = 0; frame < Math.min(times.length, MOST_FRAMES); frame++) {
    for (const bone of skeleton.bones) {
      const [turn, place] = [tracks.get(`${bone.name}.quaternion`), tracks.get(`${bone.name}.position`)];
      if (turn) bone.quaternion.fromArray(turn, 4 * frame);
      if (place) bone.position.fromArray(place, 3 * frame);
    }
    group.updateMatrixWorld(true);
    const now = source.sample();
    poses.push(Float32Array.from(now.poses));
    trans.push([...now.trans]);
  }
  return { fps: times.length > 1 ? 1 / (times[1] - times[0]) : 30, poses, trans };
}

async function readNpz(file) {
  const arrays = await unzipped(file);
  const { poses: turns, trans: places } = arrays;
  if (!turns) throw refused(file.name, "an array poses, as of AMASS", Object.keys(arrays).join(", ") || "nothing");
  const [frames, ...rest] = turns.shape;
  const width = rest.reduce((product, one) => product * one, 1);
  if (width < 63) throw refused(file.name, "21 joints or more a frame", `${width} numbers`);
  const fps = Number((arrays.mocap_framerate ?? arrays.mocap_frame_rate)?.values[0] ?? 30);
  const upright = rest.length > 1; // our own lie in our axes, AMASS has z up
  const poses = [];
  const trans = [];
  for (let frame = 0; frame < frames; frame++) {
    const pose = new Float32Array(3 * JOINTS);
    const end = Math.min(width, width > 72 ? HANDS_FROM : 72);
    for (let k = 0; k < end; k++) pose[k] = turns.values[frame * width + k];
    const place = places ? Array.from(places.values.slice(3 * frame, 3 * frame + 3), Number) : [0, 0, 0];
    if (!upright) stand(pose);
    poses.push(pose);
    trans.push(upright ? place : [place[0], place[2], -place[1]]);
  }
  return { fps, poses, trans };
}

// From z up to y up: the root turns by -90 degrees about x.
function stand(pose) {
  const turn = new Quaternion().setFromEuler(new Euler(-Math.PI / 2, 0, 0)).multiply(rotationOf(pose, 0));
  writeRotationVector(turn, pose, 0);
}

// The arrays of an npz, { shape, values } by name: a zip of npy files, stored or deflated.
async function unzipped(file) {
  const bytes = await file.arrayBuffer();
  const view = new DataView(bytes);
  let end = bytes.byteLength - 22;
  while (end >= 0 && view.getUint32(end, true) !== 0x06054b50) end -= 1;
  if (end < 0) throw refused(file.name, "an npz", "no zip file");
  const arrays = {};
  let at = view.getUint32(end + 16, true);
  for (let left = view.getUint16(end + 10, true); left > 0; left--) {
    const length = view.getUint16(at + 28, true);
    const name = new TextDecoder().decode(new Uint8Array(bytes, at + 46, length));
    const packed = view.getUint16(at + 10, true);
    const local = view.getUint32(at + 42, true);
    const start = local + 30 + view.getUint16(local + 26, true) + view.getUint16(local + 28, true);
    const content = new Blob([new Uint8Array(bytes, start, view.getUint32(at + 20, true))]);
    const plain = packed ? content.stream().pipeThrough(new DecompressionStream("deflate-raw")) : content.stream();
    const array = npy(await new Response(plain).arrayBuffer());
    if (array) arrays[name.replace(/\.npy$/, "")] = array;
    at += 46 + length + view.getUint16(at + 30, true) + view.getUint16(at + 32, true);
  }
  return arrays;
}

const KINDS = { f4: Float32Array, f8: Float64Array, i4: Int32Array, i8: BigInt64Array };

// The numbers of an npy file; null for what are none.
function npy(bytes) {
  const view = new DataView(bytes);
  const long = view.getUint8(6) > 1;
  const start = long ? 12 : 10;
  const length = long ? view.getUint32(8, true) : view.getUint16(8, true);
  const header = new TextDecoder().decode(new Uint8Array(bytes, start, length));
  const kind = /'descr': '[<|]?([a-zA-Z]\d+)'/.exec(header)?.[1];
  const shape = (/'shape': \(([^)]*)\)/.exec(header)?.[1] ?? "").split(",").filter((one) => one.trim()).map(Number);
  if (!KINDS[kind] || /'fortran_order': True/.test(header)) return null;
  return { shape, values: new KINDS[kind](bytes.slice(start + length)) };
}
