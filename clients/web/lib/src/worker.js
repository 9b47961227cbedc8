// The worker: takes the layers once, with what folds need where they are made here, and again where that changes; then
// messages with arrays to fill, which come back filled. rest: the last frame holds, and is of that time [s].
import { Decoder } from "./decode.js";

let decoder = null;
let making = null; // a promise, while folds are made ready
let failure = "";

self.onmessage = ({ data }) => {
  if (data.layers && !data.folds) decoder = new Decoder(data.layers);
  if (data.folds) {
    failure = "";
    making = import("./folding.js")
      .then(({ Folding }) => Folding.make(data.folds, data.layers[0].layout))
      .then((folding) => (decoder = new Decoder(data.layers, folding)))
      .catch((error) => (failure = error.message))
      .finally(() => (making = null));
  }
  if (making) making.then(() => take(data));
  else take(data);
};

function take({ message, body, targets, rest }) {
  if (rest !== undefined) decoder?.folding?.rest(rest);
  if (!message) return;
  const answer = { targets, filled: false, error: failure };
  try {
    answer.filled = !failure && decoder.decode(message, targets, body);
  } catch (error) {
    answer.error = error.message;
  }
  self.postMessage(answer, targets.flatMap(({ positions, normals }) => [positions.buffer, normals.buffer]));
}
