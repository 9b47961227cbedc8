// The worker: takes the layers once, and what folds need, where it makes them; then messages with arrays to fill, which
// come back filled. rest: the last frame holds, and is of that time [s].
import { Decoder } from "./decode.js";
import { Folding } from "./folding.js";

let decoder = null;
let making = null; // a promise, while folds are made ready
let failure = "";

self.onmessage = ({ data }) => {
  if (data.layers) decoder = new Decoder(data.layers);
  if (data.folds) {
    making = Folding.make(data.folds)
      .then((folding) => (decoder.folding = folding))
      .catch((error) => (failure = error.message))
      .finally(() => (making = null));
  }
  if (making) making.then(() => take(data));
  else take(data);
};

function take({ message, body, targets, rest }) {
  if (rest !== undefined) decoder.folding?.rest(rest);
  if (!message) return;
  const answer = { targets, filled: false, error: failure };
  try {
    answer.filled = !failure && decoder.decode(message, targets, body);
  } catch (error) {
    answer.error = error.message;
  }
  self.postMessage(answer, targets.flatMap(({ positions, normals }) => [positions.buffer, normals.buffer]));
}
