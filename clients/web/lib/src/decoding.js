// Messages become vertices in a worker, or on the page's own thread where none can be made.
import { Decoder, makeTargets } from "./decode.js";

// The worker's script as text, which build.mjs puts in: so it needs no address of its own, whoever bundles this.
/* global WORKER_TEXT */
function inlineWorker() {
  if (typeof WORKER_TEXT !== "string" || typeof Worker === "undefined") return null;
  const address = URL.createObjectURL(new Blob([WORKER_TEXT], { type: "text/javascript" }));
  return new Worker(address);
}

export class Decoding {
  // layers: as Decoder takes them. makeWorker: a function that gives another worker than our own, or null. folds: what
  // Folding.make takes, where folds are made here.
  constructor(layers, makeWorker = inlineWorker, folds = null) {
    this.layers = layers;
    this.folds = folds;
    this.targets = makeTargets(layers);
    this.pending = null;
    this.worker = null;
    try {
      this.worker = makeWorker?.() ?? null;
    } catch {
      // A page may forbid workers by its security policy: its own thread does it.
    }
    if (!this.worker) return;
    this.worker.onmessage = ({ data }) => this.#answered(data);
    this.worker.onerror = (event) => {
      event.preventDefault?.();
      this.#alone();
    };
    this.worker.postMessage({ layers, folds });
  }

  // Promises positions and normals by layer, good until the next call, or null where the message is of other
  // garments. One message at a time. body: as Decoder.decode() takes it.
  decode(message, body = null) {
    return new Promise((resolve, reject) => {
      this.pending = { message, body, resolve, reject };
      if (!this.worker) {
        this.#here();
        return;
      }
      const { targets } = this;
      const moved = targets.flatMap((one) => [one.positions.buffer, one.normals.buffer]);
      this.worker.postMessage({ message, body, targets }, moved);
    });
  }

  // Other constants of folds from the next message on; what they remember is forgotten.
  refold(folds) {
    this.folds = folds;
    this.decoder = null;
    this.worker?.postMessage({ layers: this.layers, folds });
  }

  // The last frame holds, and is of the time [s].
  rest(timeS) {
    if (!this.folds) return;
    if (this.worker) this.worker.postMessage({ rest: timeS });
    else this.decoder?.folding?.rest(timeS);
  }

  async #here() {
    const { message, body, resolve, reject } = this.pending;
    this.pending = null;
    try {
      this.decoder ??= new Decoder(this.layers, await this.#folding());
      resolve(this.decoder.decode(message, this.targets, body) ? this.targets : null);
    } catch (error) {
      reject(error);
    }
  }

  // What makes folds on the page's own thread; loaded where a client makes them, and not before.
  async #folding() {
    if (!this.folds) return null;
    const { Folding } = await import("./folding.js");
    return Folding.make(this.folds, this.layers[0].layout);
  }

  #answered({ targets, filled, error }) {
    const { resolve, reject } = this.pending;
    this.pending = null;
    this.targets = targets;
    if (error) reject(new Error(error));
    else resolve(filled ? targets : null);
  }

  // The worker did not load: goes on without it, with other arrays in place of those that it has.
  #alone() {
    this.worker = null;
    this.targets = makeTargets(this.layers);
    if (this.pending) this.#here();
  }

  close() {
    this.worker?.terminate();
    this.worker = null;
    this.pending = null;
  }
}
