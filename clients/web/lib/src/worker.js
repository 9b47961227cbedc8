// The worker: takes the layers once, then messages with arrays to fill; the arrays come back filled.
import { Decoder } from "./decode.js";

let decoder = null;

self.onmessage = ({ data: { layers, message, targets } }) => {
  if (layers) {
    decoder = new Decoder(layers);
    return;
  }
  const answer = { targets, filled: false, error: "" };
  try {
    answer.filled = decoder.decode(message, targets);
  } catch (error) {
    answer.error = error.message;
  }
  self.postMessage(answer, targets.flatMap(({ positions, normals }) => [positions.buffer, normals.buffer]));
};
