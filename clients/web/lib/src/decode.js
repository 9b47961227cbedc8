// Positions and normals of garments from messages of the wire: what a worker computes, or the page where there is none.
import { JetSurface } from "./jets.js";
import { FLAG_UNLIKE, KIND, dequantise, kindOf, unpackFrame, unpackJets, unpackLayout } from "./wire.js";

export class Decoder {
  // layers: of each garment of a frame, the innermost first: vertexCount; faces, 3 vertices a triangle; copies, the
  // vertices that come again behind all others (meshes.js); layout, the bytes of its LAYOUT where jets come, or null.
  // folding: the Folding of the only layer, or null.
  constructor(layers, folding = null) {
    this.folding = folding;
    this.layers = layers.map(({ layout, ...layer }) => {
      const unpacked = layout && unpackLayout(layout);
      const surface = unpacked && !folding ? new JetSurface(unpacked) : null;
      return { ...layer, surface, patchCount: unpacked ? unpacked.count : 0 };
    });
  }

  // Fills positions (from the root [m]) and normals of each layer; false where the message is of other garments.
  // body: { pose, effort }, which folds need: 72 numbers [rad], and what the service said of its opening.
  decode(message, targets, body = null) {
    return this.fill(kindOf(message) === KIND.JETS ? unpackJets(message) : unpackFrame(message), targets, body);
  }

  // As decode(), of what unpackJets() or unpackFrame() gives.
  fill(frame, targets, body = null) {
    const ofJets = "jet" in frame;
    const count = (layer) => (ofJets ? layer.patchCount : layer.vertexCount);
    if (this.layers.reduce((sum, layer) => sum + count(layer), 0) !== frame.header.count) return false;
    let first = 0;
    this.layers.forEach((layer, index) => {
      const end = first + count(layer);
      const { positions, normals } = targets[index];
      if (!ofJets) dequantise({ header: frame.header, steps: frame.steps.subarray(3 * first, 3 * end) }, positions);
      else if (this.folding) this.#drape(frame, positions, body);
      else layer.surface.evaluate(frame, positions, first);
      finish(layer, positions, normals);
      first = end;
    });
    return true;
  }

  // Fills positions and normals of the only layer for a pose, { pose, root, timeS, unlike }, whose network is here.
  pose(asked, [{ positions, normals }], effort) {
    this.#folded(null, asked, positions, effort);
    finish(this.layers[0], positions, normals);
    return true;
  }

  #drape(frame, positions, { pose, effort }) {
    const { flags, client_time_s: timeS, root } = frame.header;
    this.#folded(frame, { pose, root, timeS, unlike: flags & FLAG_UNLIKE }, positions, effort);
  }

  #folded(jets, { pose, root, timeS, unlike }, positions, effort) {
    const steps = unlike ? Math.max(effort.folds, effort.safe_folds) : effort.folds;
    this.folding.drape(jets, positions, { pose, root, timeS, steps, effort });
  }
}

function finish(layer, positions, normals) {
  vertexNormals(positions, layer, normals);
  repeat(positions, layer);
  repeat(normals, layer);
}

// Arrays for what decode() fills.
export const makeTargets = (layers) =>
  layers.map(({ vertexCount, copies }) => {
    const length = 3 * (vertexCount + copies.length);
    return { positions: new Float32Array(length), normals: new Float32Array(length) };
  });

// The mean normal of the triangles around each vertex, by their areas.
function vertexNormals(positions, { faces, vertexCount }, normals) {
  const end = 3 * vertexCount;
  normals.fill(0, 0, end);
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
    const [x, y, z] = [positions[a], positions[a + 1], positions[a + 2]];
    const [ux, uy, uz] = [positions[b] - x, positions[b + 1] - y, positions[b + 2] - z];
    const [vx, vy, vz] = [positions[c] - x, positions[c + 1] - y, positions[c + 2] - z];
    const [nx, ny, nz] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    normals[a] += nx; normals[a + 1] += ny; normals[a + 2] += nz;
    normals[b] += nx; normals[b + 1] += ny; normals[b + 2] += nz;
    normals[c] += nx; normals[c + 1] += ny; normals[c + 2] += nz;
  }
  for (let i = 0; i < end; i += 3) {
    const [x, y, z] = [normals[i], normals[i + 1], normals[i + 2]];
    const length = Math.sqrt(x * x + y * y + z * z) || 1; // a vertex without triangles keeps zeros
    normals[i] = x / length;
    normals[i + 1] = y / length;
    normals[i + 2] = z / length;
  }
}

function repeat(numbers, { copies, vertexCount }) {
  let to = 3 * vertexCount;
  for (const vertex of copies) {
    numbers[to++] = numbers[3 * vertex];
    numbers[to++] = numbers[3 * vertex + 1];
    numbers[to++] = numbers[3 * vertex + 2];
  }
}
