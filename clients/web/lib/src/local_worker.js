// The worker of what is draped without a service: takes where its folder is, then the messages that worker.js takes, of
// which frames are POSE messages. The port is told what computes, or why nothing does.
import { filesOf } from "./files.js";
import { LocalDecoder } from "./local_decoder.js";

let setup = null;
let ready = null; // a promise

self.onmessage = ({ data }) => {
  if (data.base) setup = data;
  if (data.layers) {
    const { base, about, port } = setup;
    ready = LocalDecoder.make({ about, file: filesOf(base) }, data.layers, data.folds);
    ready.then(({ told }) => port.postMessage(told), (error) => port.postMessage({ error: { ...error, message: error.message } }));
  }
  ready?.then((decoder) => take(decoder, data), ({ message }) => answer(data, false, message));
};

function take(decoder, data) {
  if (data.rest !== undefined) decoder.rest(data.rest);
  if (!data.message) return;
  try {
    answer(data, decoder.decode(data.message, data.targets, data.body), "");
  } catch (error) {
    answer(data, false, error.message);
  }
}

function answer({ message, targets }, filled, error) {
  if (!message) return;
  self.postMessage({ targets, filled, error }, targets.flatMap(({ positions, normals }) => [positions.buffer, normals.buffer]));
}
