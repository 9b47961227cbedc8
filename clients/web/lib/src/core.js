// A service, and what is worn there, without any engine that draws.
import { DrapeError } from "./errors.js";
import { Rest } from "./rest.js";
import { Stream } from "./stream.js";
import { Wearing } from "./wearing.js";

export { DrapeError } from "./errors.js";
export { landmarkSource } from "./landmarks.js";
export { clipSource } from "./sources.js";

const POLL_MS = 200;

export class Drape {
  // worker: a function that gives a Worker which imports "@drape/client/worker", or null for none; left out, our own.
  // key, ticket, fetch: as Rest takes them.
  constructor(url, { key, ticket, fetch, worker } = {}) {
    this.rest = new Rest(new URL(url, globalThis.location?.href).href, { key, ticket, fetch });
    this.makeWorker = worker;
    this.worn = new Set();
    this.motionsKept = new Map();
  }

  // Asks the service who it is.
  async open() {
    this.health = await this.rest.health();
    return this;
  }

  // What takes the poses of something worn, and gives its frames.
  makeStream(heard) {
    return new Stream({ base: this.rest.base, ticket: () => this.rest.ticket(), ...heard });
  }

  // The compiled engine, which makes folds here.
  async engine() {
    const { compiled } = await import("./folds.js");
    return compiled();
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

  // A clip with its numbers, on the ground for the body in the shape betas or for an avatar; fetched once.
  motion(name, betas = [], avatar = null) {
    const key = `${name} ${avatar ?? betas}`;
    if (!this.motionsKept.has(key)) {
      const fetched = this.rest.motion(name, betas, avatar);
      fetched.catch(() => this.motionsKept.delete(key));
      this.motionsKept.set(key, fetched);
    }
    return this.motionsKept.get(key);
  }

  // Rest joints [m] and height of the soles of the service's body, or of an avatar.
  async body(betas = [], avatar = null) {
    if (avatar === null) return this.rest.body(this.health.body, betas);
    const { rest_joints: joints, floor_m } = await this.rest.avatar(avatar);
    return { joints, floor_m };
  }

  avatars() {
    return this.rest.avatars();
  }

  // The id of the character in the bytes of a GLB or VRM, which wear() takes as its option avatar. Takes seconds. alive:
  // whether its own clothes become garments, for the option alive of wear().
  async avatar(bytes, name = "avatar", { alive } = {}) {
    let job = await this.rest.sendAvatar(bytes, name, alive);
    while (job.state === "queued" || job.state === "running") {
      await new Promise((resolve) => setTimeout(resolve, POLL_MS));
      job = await this.rest.job(job.id);
    }
    if (job.state === "done") return job.avatar;
    const ended = { name: "avatar", expected: "a character", got: job.state, cure: "Send it again.", kind: "Unavailable" };
    throw new DrapeError(job.problem ?? ended);
  }

  // The garment, or several over each other, the innermost first, as soon as the service has opened its stream.
  async wear(garments, options = {}) {
    const names = Array.isArray(garments) ? garments : [garments];
    if ((!names.length && !options.alive) || names.some((name) => typeof name !== "string")) {
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
