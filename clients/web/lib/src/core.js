// A service, and what is worn there, without any engine that draws.
import { DrapeError } from "./errors.js";
import { Rest } from "./rest.js";
import { Wearing } from "./wearing.js";

export { DrapeError } from "./errors.js";
export { clipSource } from "./sources.js";

export class Drape {
  // worker: a function that gives a Worker which imports "@drape/client/worker", or null for none; left out, our own.
  constructor(url, { key, ticket, worker } = {}) {
    this.rest = new Rest(new URL(url, globalThis.location?.href).href, { key, ticket });
    this.makeWorker = worker;
    this.worn = new Set();
    this.motionsKept = new Map();
  }

  // Asks the service who it is.
  async open() {
    this.health = await this.rest.health();
    return this;
  }

  garments() {
    return this.rest.garments();
  }

  fabrics() {
    return this.rest.fabrics();
  }

  tiers() {
    return this.rest.tiers();
  }

  motions() {
    return this.rest.motions();
  }

  // A clip with its numbers, on the ground for the body in the shape betas; fetched once.
  motion(name, betas = []) {
    const key = `${name} ${betas}`;
    if (!this.motionsKept.has(key)) {
      const fetched = this.rest.motion(name, betas);
      fetched.catch(() => this.motionsKept.delete(key));
      this.motionsKept.set(key, fetched);
    }
    return this.motionsKept.get(key);
  }

  // Rest joints [m] and height of the soles of the service's body.
  body(betas = []) {
    return this.rest.body(this.health.body, betas);
  }

  // The garment, or several over each other, the innermost first, as soon as the service has opened its stream.
  async wear(garments, options = {}) {
    const names = Array.isArray(garments) ? garments : [garments];
    if (!names.length || names.some((name) => typeof name !== "string")) {
      const words = { name: "garments", expected: "the id of one, or a list of ids", got: JSON.stringify(garments) ?? "nothing" };
      throw new DrapeError({ ...words, cure: "garments() lists them.", kind: "InputError" });
    }
    const wearing = new Wearing(this, names, options);
    this.worn.add(wearing);
    return wearing.open(this.makeWorker);
  }

  close() {
    for (const wearing of this.worn) wearing.close();
  }
}

export const connect = (url, options) => new Drape(url, options).open();
