// Meshes at rest as they come (drape/wire/mesh_messages.py): a garment's triangles for graphics cards, and the body.
import { BYTES, readHeader } from "./wire.js";

// Reads whole numbers one array after the other: differences from the number lag places before, zigzagged, in planes of bytes.
class Whole {
  constructor(message, at) {
    this.bytes = new Uint8Array(message);
    this.at = at;
  }

  next(count, lag) {
    const { bytes, at } = this;
    const numbers = new Int32Array(count);
    for (let i = 0; i < count; i++) {
      const code = bytes[at + i] | (bytes[at + count + i] << 8) | (bytes[at + 2 * count + i] << 16) | (bytes[at + 3 * count + i] << 24);
      numbers[i] = ((code >>> 1) ^ -(code & 1)) + (i < lag ? 0 : numbers[i - lag]);
    }
    this.at += 4 * count;
    return numbers;
  }
}

function scaled(steps, step) {
  const numbers = new Float32Array(steps.length);
  for (let i = 0; i < steps.length; i++) numbers[i] = step * steps[i];
  return numbers;
}

// A garment's triangles: index, 3 corners each, for positions and texture coordinates uv alike, which are null where it has
// none. Where these have a seam, vertices come twice: the delivered ones first, in their order, then copies; faces are index
// without those. uvMetres: of a unit of uv, null where that is not known.
export function unpackMesh(message) {
  const { count: vertexCount, copies: copyCount, triangles, uv_step, uv_metres } = readHeader(message, "MESH", BYTES.MESH_HEADER);
  const numbers = new Whole(message, BYTES.MESH_HEADER);
  const copies = Uint32Array.from(numbers.next(copyCount, 1));
  const index = Uint32Array.from(numbers.next(3 * triangles, 1));
  const faces = copyCount ? index.map((at) => (at < vertexCount ? at : copies[at - vertexCount])) : index;
  const uv = uv_step ? scaled(numbers.next(2 * (vertexCount + copyCount), 2), uv_step) : null;
  return { vertexCount, faces, index, copies, uv, uvMetres: uv_metres || null };
}

// The body at rest: index; positions [m]; its joints [m], 3 numbers each; bones and weights, 4 of each vertex.
export function unpackBody(message) {
  const { count, triangles, step_m, weight_step, joints } = readHeader(message, "BODY", BYTES.BODY_HEADER);
  const numbers = new Whole(message, BYTES.BODY_HEADER);
  const index = Uint32Array.from(numbers.next(3 * triangles, 1));
  const positions = scaled(numbers.next(3 * count, 3), step_m);
  const bones = Uint8Array.from(numbers.next(4 * count, 4));
  const others = scaled(numbers.next(3 * count, 3), weight_step);
  const weights = new Float32Array(4 * count);
  for (let i = 0; i < count; i++) {
    const three = others.subarray(3 * i, 3 * i + 3);
    weights.set(three, 4 * i + 1);
    weights[4 * i] = 1 - three[0] - three[1] - three[2];
  }
  return { index, positions, joints, bones, weights };
}
