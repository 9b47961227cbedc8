// The step of folds in WebAssembly: one garment on one body, which remembers the frame before (folds/step.ts).
import { KIND, MAGIC, WIRE_VERSION } from "./wire.js";

const HEADER = 16; // bytes of every message
const ENTRY = 8; // of an array: the number of its elements, and of its bytes

export class Folding {
  // module: the compiled step (folds.js); constants: a FOLDS message.
  static async make({ module, constants }) {
    const abort = () => {
      throw new Error("folds ended");
    };
    const { exports } = await WebAssembly.instantiate(module, { env: { abort } });
    return new Folding(exports, constants);
  }

  constructor(step, constants) {
    this.step = step;
    const view = new DataView(constants);
    const [magic, version, kind] = [view.getUint32(0, true), view.getUint8(4), view.getUint8(5)];
    const count = view.getUint32(12, true);
    if (magic !== MAGIC || version !== WIRE_VERSION || kind !== KIND.FOLDS || count !== step.arrayCount()) {
      throw new Error("not a FOLDS message of this wire version: reload the page");
    }
    let from = HEADER + ENTRY * count;
    for (let i = 0; i < count; i++) {
      const [numbers, bytes] = [0, 4].map((part) => view.getUint32(HEADER + ENTRY * i + part, true));
      const to = step.reserve(i, numbers, bytes);
      new Uint8Array(step.memory.buffer, to, bytes).set(new Uint8Array(constants, from, bytes));
      from += bytes + (-bytes & 3);
    }
    step.begin();
  }

  // The skin's samples, 8 numbers each, in a pose of 72 numbers [rad]; good until the next call.
  skin(pose) {
    const { step } = this;
    new Float32Array(step.memory.buffer, step.poseAt(), 72).set(pose);
    step.pose();
    return new Float32Array(step.memory.buffer, step.skinAt(), 8 * step.skinCount());
  }

  // Puts folds into positions (3 numbers a vertex, from the root [m]), which are the network's, and says what happened.
  // pose: 72 numbers [rad]; the rest as the service said of its opening.
  fold(positions, { pose, timeS, steps, settle, contact, clearanceM }) {
    const { step } = this;
    this.skin(pose);
    const vertices = new Float32Array(step.memory.buffer, step.verticesAt(), 3 * step.vertexCount());
    vertices.set(positions.subarray(0, vertices.length));
    const happened = step.fold(timeS, steps, settle, contact, clearanceM);
    positions.set(vertices);
    return happened;
  }

  // The cloth hangs still, and is as old as it was at the time [s].
  rest(timeS) {
    this.step.rest(timeS);
  }
}
