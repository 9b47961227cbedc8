// One frame of folds. A copy of drape/live/fold_step.py for browsers: one garment, without colliders. An instance of this
// module is one garment on one body, and remembers the frame before.
// tests/clients/test_folds_step.py holds this folder to float64.
import * as A from "./arrays";
import { at, constant, reserve, reserved } from "./arrays";
import { MOST_CELLS, SAMPLE, follow, stuckPlaces, touch, writeGrip } from "./contact";
import { FRAMES, ease, keepResidual, surfaceFrames, toFrames, toWorld } from "./frames";
import { lift } from "./lift";
import { keepApart, roomBytes } from "./room";
import { poseSkin } from "./skin";
import { PLANES, descend, gradientAt, leash, stick } from "./sweeps";
import { tangleBytes, untangle } from "./untangle";
import { LANES, POINT, add, all, apart, ax, ay, az, mad, sub, whole } from "./vectors";
import { wholeStep } from "./whole";

export { reserve };

const PAUSE_S: f64 = 0.25, CUT_M: f64 = 0.3, SHORTEST_STEP_S: f64 = 1 / 240.0, FIRST_STEP_S: f64 = 1 / 30.0;
const TURNS: i32 = 4;
const MOMENTUM: f64 = 0.9, FAST_MOMENTUM: f64 = 0.7, STIFF_MOMENTUM: f64 = 0.5;
const SETTLING_MOMENTUM: f64 = 0.98, LONG_ROUNDS: i32 = 16;
const FAR_M: f64 = 0.25, SLOW_M: f64 = 0.01, FAST_M: f64 = 0.02;
const FAST_SWEEPS: i32 = 2;
const SHAKEN: f64 = 0.5, SHAKEN_M_S: f64 = 0.1;
const STIFF_SHARE: f64 = 0.5, STIFF_N_PER_M: f64 = 1000;
const LEAST_M: f64 = 0.0003, WAY_M: f64 = 0.002, EASE: f64 = 0.5;
// What fold() says of a frame.
const SETTLED: i32 = 1, RESET: i32 = 2, LOST: i32 = 4;

let places: i32 = 0, blocks: i32 = 0, vertices: i32 = 0;
let input: usize = 0, poseNumbers: usize = 0, skin: usize = 0;
let network: usize = 0, before: usize = 0, x: usize = 0, way: usize = 0, last: usize = 0, gradient: usize = 0;
let residual: usize = 0, velocity: usize = 0, grip: usize = 0, stuck: usize = 0;
let touched: usize = 0, others: usize = 0, planes: usize = 0, frames: usize = 0;
let factorRows: usize = 0, panelRows: usize = 0, grid: usize = 0, room: usize = 0, tangleRoom: usize = 0;

let known: bool = false; // whether there is a frame before
let timeS: f64 = 0;
let turn: i32 = 0;

// Makes room for frames, when all arrays of constants are there.
export function begin(): void {
  places = reserved(A.VERTEX);
  blocks = places / LANES;
  vertices = reserved(A.PLACE);
  input = heap.alloc(<usize>vertices * 12);
  poseNumbers = heap.alloc(72 * 4);
  skin = heap.alloc(<usize>reserved(A.REACH_M2) * SAMPLE);
  network = newPoints(); before = newPoints(); x = newPoints(); way = newPoints(); last = newPoints();
  gradient = newPoints(); residual = newPoints(); velocity = newPoints(); grip = newPoints(); stuck = newPoints();
  touched = heap.alloc(<usize>places << 2);
  others = heap.alloc(<usize>places << 2);
  planes = heap.alloc(<usize>blocks * PLANES);
  frames = heap.alloc(<usize>blocks * FRAMES);
  factorRows = newPoints();
  panelRows = heap.alloc(<usize>(vertices + LANES) * 12 + 64);
  grid = heap.alloc((<usize>(MOST_CELLS + 1) << 2) + (<usize>reserved(A.REACH_M2) << 3));
  room = heap.alloc(roomBytes(reserved(A.CLUSTERS) / LANES));
  tangleRoom = heap.alloc(tangleBytes(reserved(A.TANGLE_CORNER) / (3 * LANES), places));
}

function newPoints(): usize { return heap.alloc(<usize>places * POINT + 64); }

// Where the network's vertices are written before fold(), three numbers each, and where those with folds are then.
export function verticesAt(): usize { return input; }
export function vertexCount(): i32 { return vertices; }
export function arrayCount(): i32 { return A.ARRAYS; }
// Where the 72 numbers of a pose are written before pose(), which poses the skin, and where its samples are then.
export function poseAt(): usize { return poseNumbers; }
export function skinAt(): usize { return skin; }
export function skinCount(): i32 { return reserved(A.REACH_M2); }
export function pose(): void { poseSkin(poseNumbers, skin); }

// The frame before counts as one of the time [s]: nothing has moved since.
export function rest(atS: f64): void { timeS = atS; }

// Replaces the network's vertices by those with folds at the time [s]; says what happened. within: cloth keeps apart from itself.
export function fold(atS: f64, steps: i32, settle: i32, within: bool, clearance: f32): i32 {
  for (let p = 0; p < places; p++) {
    const from = input + <usize>whole(at(A.VERTEX), p) * 12, to = network + (<usize>p << 4);
    store<f32>(to, load<f32>(from));
    store<f32>(to, load<f32>(from, 4), 4);
    store<f32>(to, load<f32>(from, 8), 8);
    store<f32>(to, 0, 12);
  }
  let found = follows(atS) ? 0 : SETTLED;
  if (found & SETTLED) withoutPast();
  let far = advance(atS, steps, settle, within, clearance, (found & SETTLED) != 0);
  if (!(far <= FAR_M)) {
    found |= RESET;
    withoutPast();
    far = advance(atS, steps, settle, within, clearance, true);
  }
  known = far <= FAR_M;
  if (!known) return found | LOST; // the network's vertices are there still
  for (let v = 0; v < vertices; v++) {
    const from = x + ((<usize>whole(at(A.PLACE), v)) << 4), to = input + <usize>v * 12;
    store<f32>(to, load<f32>(from));
    store<f32>(to, load<f32>(from, 4), 4);
    store<f32>(to, load<f32>(from, 8), 8);
  }
  const kept = before;
  before = network;
  network = kept;
  timeS = atS;
  turn = (turn + 1) % TURNS;
  return found;
}

function follows(atS: f64): bool {
  if (!known || !(atS >= timeS && atS - timeS <= PAUSE_S)) return false;
  let most: f32 = 0;
  for (let p = 0; p < places; p++) most = max<f32>(most, apart(network, p, before, p));
  return <f64>most <= CUT_M * CUT_M;
}

function withoutPast(): void {
  const bytes = <usize>places * POINT;
  memory.copy(before, network, bytes);
  memory.fill(residual, 0, bytes);
  memory.fill(velocity, 0, bytes);
  memory.fill(grip, 0, bytes);
  memory.copy(touched, at(A.INDEX), <usize>places << 2);
  memory.fill(others, 255, <usize>places << 2);
  turn = 0;
}

// The RMS way [m] of the network's vertices.
function movedM(): f64 {
  let sum: f64 = 0;
  for (let v = 0; v < vertices; v++) {
    const p = whole(at(A.PLACE), v);
    sum += <f64>apart(network, p, before, p);
  }
  return Math.sqrt(sum / <f64>vertices);
}

// Moves x and the memory on by a frame; returns how far the farthest vertex is from the network, NaN where one is.
function advance(atS: f64, steps: i32, settle: i32, within: bool, clearance: f32, settled: bool): f64 {
  const stepS = settled ? FIRST_STEP_S : max<f64>(atS - timeS, SHORTEST_STEP_S);
  const rounds = settled ? settle : 1, wayM = movedM();
  const calm = min<f64>(max<f64>((FAST_M - wayM) / (FAST_M - SLOW_M), 0), 1);
  // The pace: paced() of pace.py.
  const half = max<i32>(steps / 2, 1);
  let wholes = steps, sweeps = half + (calm < 1 ? FAST_SWEEPS : 0), share = calm;
  let momentum = FAST_MOMENTUM + calm * (MOMENTUM - FAST_MOMENTUM);
  if (<f64>(constant(A.WARP) + constant(A.WEFT)) > STIFF_N_PER_M) { // each is half of the fabric's
    momentum = STIFF_MOMENTUM + calm * (MOMENTUM - STIFF_MOMENTUM);
    sweeps = calm == 1 ? half : steps + FAST_SWEEPS;
    share = STIFF_SHARE + calm * (1 - STIFF_SHARE);
  } else if (calm == 0) {
    wholes = 0;
    sweeps = steps + FAST_SWEEPS;
  }
  if (settled && rounds >= LONG_ROUNDS) momentum = SETTLING_MOMENTUM;
  const gripLeft = 1 - (1 - SHAKEN) * min<f64>(wayM / (SHAKEN_M_S * stepS), 1);
  const untangleM: f32 = settled ? <f32>WAY_M : <f32>min<f64>(WAY_M, max<f64>(wayM, LEAST_M));

  stuckPlaces(grip, touched, places, skin, stuck);
  surfaceFrames(network, blocks, frames);
  toWorld(residual, 1, blocks, frames, x);
  toWorld(velocity, <f32>stepS, blocks, frames, way);
  keepResidual(x, before, network, blocks, frames, last);
  for (let p: usize = 0; p < <usize>places << 4; p += 16) v128.store(x + p, add(v128.load(x + p), v128.load(network + p)));

  follow(network, places, skin, touched);
  leash(blocks, planes);
  stick(blocks, stuck, settled ? 0 : <f32>gripLeft * constant(A.FRICTION), planes);
  for (let round = 0; round < rounds; round++) {
    touch(x, places, skin, touched, others, settled ? -1 : turn, planes, grid);
    if (within) keepApart(x, planes, room);
    if (settled && round == 0) for (let sweep = 0; sweep < rounds; sweep++) descend(x, blocks, planes, network);
    for (let step = 0; step < wholes; step++) {
      memory.copy(last, x, <usize>places * POINT);
      goOn(<f32>momentum);
      gradientAt(x, blocks, planes, network, gradient);
      wholeStep(x, gradient, <f32>share, vertices, factorRows, panelRows);
      setWay();
    }
    for (let sweep = 0; sweep < sweeps; sweep++) {
      memory.copy(last, x, <usize>places * POINT);
      if (wholes == 0) goOn(<f32>momentum);
      descend(x, blocks, planes, network);
      if (wholes == 0) setWay();
    }
    if (within) {
      const crossed = untangle(x, places, untangleM, tangleRoom);
      if (crossed) ease(x, network, crossed, <f32>(EASE / WAY_M) * untangleM, blocks, last);
    }
  }
  if (clearance > 0) lift(x, blocks, planes, clearance);

  if (settled) memory.copy(stuck, x, <usize>places * POINT);
  writeGrip(x, stuck, touched, places, skin, grip);
  toFrames(x, network, 1, blocks, frames, residual);
  toFrames(way, 0, <f32>(1 / <f32>stepS), blocks, frames, velocity);
  let most: f32 = 0;
  for (let p = 0; p < places; p++) {
    const square = apart(x, p, network, p);
    if (most == most && !(square <= most)) most = square;
  }
  return Math.sqrt(<f64>most);
}

// Moves x by a share of its way, of which no more than the reach counts.
function goOn(momentum: f32): void {
  const reach = constant(A.REACH);
  for (let p = 0; p < places; p++) {
    const a = ax(way, p), b = ay(way, p), c = az(way, p);
    const share = momentum * reach / Mathf.sqrt(max<f32>(a * a + b * b + c * c, reach * reach));
    const to = x + (<usize>p << 4);
    v128.store(to, mad(v128.load(to), all(share), v128.load(way + (<usize>p << 4))));
  }
}

function setWay(): void {
  for (let p: usize = 0; p < <usize>places << 4; p += 16) v128.store(way + p, sub(v128.load(x + p), v128.load(last + p)));
}
