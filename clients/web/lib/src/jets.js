// Vertices of a garment from its posed patches: the sum over a vertex's charts of weight times
// centre + rotation (rest place + scale jet(u, v)), as drape/wire/layout.py says.
import { JET_NUMBERS } from "./wire.js";

const TERMS = JET_NUMBERS / 3;
const ORDER = 4;
const PATCH = { centre: 9, scale: 12, numbers: 13 };

export class JetSurface {
  // layout: unpackLayout's.
  constructor(layout) {
    this.layout = layout;
    this.patchCount = layout.count;
    this.vertexCount = layout.vertices;
    this.width = 4 + TERMS; // weight times [rest place in the patch, 1, basis]
    this.columns = this.#columns();
  }

  #columns() {
    const { charts, chart, chartPatch, patches, rest } = this.layout;
    const columns = new Float32Array(chartPatch.length * this.width);
    for (let entry = 0; entry < chartPatch.length; entry++) {
      const vertex = Math.floor(entry / charts);
      const patch = PATCH.numbers * chartPatch[entry];
      const [weight, u, v] = chart.subarray(3 * entry, 3 * entry + 3);
      const column = entry * this.width;
      for (let i = 0; i < 3; i++) {
        let local = 0; // along the i-th axis of the patch at rest
        for (let a = 0; a < 3; a++) local += patches[patch + 3 * a + i] * (rest[3 * vertex + a] - patches[patch + PATCH.centre + a]);
        columns[column + i] = weight * local;
      }
      columns[column + 3] = weight;
      let term = column + 4;
      for (let i = 0; i <= ORDER; i++) {
        for (let j = 0; j <= i; j++) columns[term++] = weight * u ** (i - j) * v ** j;
      }
    }
    return columns;
  }

  // Root-relative positions [m] into target (Float32Array of 3 per vertex); first: its first patch in an outfit's frame.
  evaluate({ jet, rotation, centre }, target, first = 0) {
    const { chartPatch, charts, patches } = this.layout;
    const { width, columns } = this;
    const posed = new Float32Array(this.patchCount * 3 * width); // rows x, y, z of each patch
    for (let k = 0; k < this.patchCount; k++) {
      const scale = patches[PATCH.numbers * k + PATCH.scale];
      const from = first + k;
      for (let a = 0; a < 3; a++) {
        const row = (3 * k + a) * width;
        const [r0, r1, r2] = rotation.subarray(9 * from + 3 * a, 9 * from + 3 * a + 3);
        posed.set([r0, r1, r2, centre[3 * from + a]], row);
        const at = JET_NUMBERS * from;
        for (let t = 0; t < TERMS; t++) {
          posed[row + 4 + t] = scale * (r0 * jet[at + t] + r1 * jet[at + TERMS + t] + r2 * jet[at + 2 * TERMS + t]);
        }
      }
    }
    for (let vertex = 0, entry = 0; vertex < this.vertexCount; vertex++) {
      let [x, y, z] = [0, 0, 0];
      for (const end = entry + charts; entry < end; entry++) {
        const row = 3 * width * chartPatch[entry];
        const column = width * entry;
        for (let t = 0; t < width; t++) {
          const share = columns[column + t];
          x += posed[row + t] * share;
          y += posed[row + width + t] * share;
          z += posed[row + 2 * width + t] * share;
        }
      }
      target[3 * vertex] = x;
      target[3 * vertex + 1] = y;
      target[3 * vertex + 2] = z;
    }
  }
}
