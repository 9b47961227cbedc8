// One garment, or several over each other, on one moving body: its stream, what decodes it, and where its poses come from.
import { DrapeError } from "./errors.js";
import { Decoding } from "./decoding.js";
import { unpackMesh } from "./meshes.js";
import { Pace } from "./pace.js";
import { clipSource, everyPicture, flatPose } from "./sources.js";

const OF_MESHES = ["size", "hidden"]; // options that say which meshes come

export class Wearing {
  // drape: the service's Drape; garments: ids, the innermost first; options: those of a drape.
  constructor(drape, garments, options) {
    this.drape = drape;
    this.garments = garments; // with an avatar's own clothes, once these are known
    this.spread = (changed) => changed; // options by layer, to these
    this.options = options;
    this.auto = options.folds_by === "auto"; // the client folds where it can, and keeps up with it
    this.pace = new Pace(); // of the folds that are made here
    this.folds = null; // what its folds need, where the client makes them
    this.hung = false; // whether what is drawn hangs on the cloth that is folded here
    this.layers = []; // id and topology of each garment that comes
    this.positions = this.normals = null; // of each layer, from the root
    this.root = [0, 0, 0]; // [m]
    this.bodyPose = null; // that the shown frame answers
    this.header = null; // of the shown frame (wire.js)
    this.stats = { frames: 0, skipped: 0, dropped: 0, ageS: 0, residenceS: 0, hereS: 0, bytes: 0 };
    this.state = "opening";
    this.onFrame = () => {}; // positions, normals, root and body pose have changed
    this.onFolds = () => {}; // the service makes the folds from now on: here they took pace.typicalS of a frame
    this.onState = () => {}; // (state, DrapeError or null): "open", "waiting", "refused", "closed"
    this.endSource = null;
    this.turn = 0; // counts sources
    this.begun = this.busy = false; // whether it was ever open; whether a frame is being decoded
    this.asked = []; // who waits for the answer to an opening
    this.newest = null; // the frame that waits for the decoder
    this.decoded = null; // the message whose vertices are shown
    this.stream = drape.makeStream({
      onFrame: (frame) => this.#take(frame),
      onState: (state, refusal) => this.#turnTo(state, refusal),
    });
  }

  // "client" or "server": who makes the folds of what is worn.
  get foldsBy() {
    return this.folds && this.options.folds_by === "client" ? "client" : "server";
  }

  // Fetches the meshes and opens the stream; rejects with the service's refusal.
  async open(makeWorker) {
    try {
      if (this.options.alive) this.spread = await (await import("./own_clothes.js")).nameOwn(this, (others) => this.#reopen(others));
      await this.#prepareFolds();
      return await this.#openAs(makeWorker);
    } catch (error) {
      if (!this.auto || !this.folds) {
        this.close();
        throw error;
      }
      this.#leaveFolds();
      return this.#openAs(makeWorker);
    }
  }

  // What the client needs to fold, where it is to; where it cannot and need not, the server does.
  async #prepareFolds() {
    const { folds_by: by } = this.options;
    if (by !== "client" && by !== "auto") return;
    if (this.auto && this.garments.length > 1) {
      this.#leaveFolds(); // as the service would, but before anything is fetched
      return;
    }
    this.options = { ...this.options, folds_by: "client", geometry: "jets" };
    try {
      const [module, { hung }] = await Promise.all([this.drape.engine(), this.drape.rest.garment(this.garments[0])]);
      this.folds = { module };
      this.hung = Boolean(hung) && this.options.resolution !== "fine";
    } catch (error) {
      if (!this.auto) throw error;
      this.#leaveFolds();
    }
  }

  #leaveFolds() {
    this.folds = null;
    this.hung = false;
    this.options = { ...this.options, folds_by: "server", geometry: "vertices" };
  }

  // This device is too slow: the service folds in its place. Where it will not, all stays as it is.
  async #giveUpFolds() {
    const before = { folds: this.folds, hung: this.hung, options: this.options };
    this.#leaveFolds();
    try {
      await this.#reopen();
      this.onFolds();
    } catch {
      Object.assign(this, before);
      this.#reopen().catch(() => {});
    }
  }

  // What folds need of the garment as it is worn now; coarse: whether a coarse cloth takes their steps.
  async #withConstants() {
    const { fabric, ...others } = this.options;
    const { coarse } = this.stream.opened;
    const [id] = this.garments;
    const one = { fabric: Array.isArray(fabric) ? fabric[0] : fabric, size: this.sizeOf(id), coarse, ...this.#folded(), drawn: this.hung };
    return { ...this.folds, coarse, constants: await this.drape.rest.foldConstants(id, { ...others, ...one }) };
  }

  // What is asked of the service where the cloth is folded here and something hangs on it.
  #folded() {
    return this.hung ? { resolution: "fine" } : {};
  }

  // The size of a garment that is worn; null: the usual one.
  sizeOf(id) {
    const { size = null } = this.options;
    return Array.isArray(size) ? (size[this.garments.indexOf(id)] ?? null) : size;
  }

  async #openAs(makeWorker) {
    const { hidden = [], resolution, geometry, avatar } = this.options;
    const shown = this.garments.filter((id) => !hidden.includes(id));
    const fetched = shown.map(async (id) => {
      const [mesh, layout] = await Promise.all([
        this.drape.rest.garmentMesh(id, { resolution, size: this.sizeOf(id) }),
        geometry === "jets" ? this.drape.rest.jetLayout(id, { resolution, avatar, size: this.sizeOf(id), ...this.#folded() }) : null,
      ]);
      return { id, layout, ...unpackMesh(mesh) };
    });
    [this.layers] = await Promise.all([Promise.all(fetched), this.#reopen()]);
    if (this.folds) this.folds = await this.#withConstants();
    const needed = this.layers.map(({ vertexCount, faces, copies, layout }) => ({ vertexCount, faces, copies, layout }));
    this.decoding = new Decoding(needed, makeWorker, this.folds);
    this.#decodeNewest();
    return this;
  }

  #reopen(others) {
    const [one, ...more] = this.garments;
    const worn = more.length ? { garments: this.garments } : { garment: one }; // none beside own clothes
    return new Promise((resolve, reject) => {
      this.asked.push({ resolve, reject });
      this.stream.open({ ...worn, ...this.options, ...this.#folded(), ...others });
    });
  }

  // Drapes it otherwise from now on, by options of a drape. What the service refuses changes nothing, and rejects.
  async set(changed) {
    const [options, before] = [this.spread(changed), this.options];
    const fixed = OF_MESHES.find((name) => name in options && JSON.stringify(options[name]) !== JSON.stringify(before[name]));
    if (fixed) {
      const words = { name: fixed, expected: "as it is worn", got: JSON.stringify(options[fixed]), kind: "InputError" };
      throw new DrapeError({ ...words, cure: "Its meshes would be others: wear() it." });
    }
    this.options = { ...before, ...options };
    const folded = this.foldsBy === "client";
    try {
      await this.#reopen();
      const others = "fabric" in options || "betas" in options || this.stream.opened.coarse !== this.folds?.coarse;
      if (folded && others) this.decoding.refold((this.folds = await this.#withConstants()));
    } catch (error) {
      if (folded && this.auto && error.name === "folds_by") {
        this.#leaveFolds();
        await this.#reopen();
        return;
      }
      this.options = before;
      if (this.state === "refused" || folded) this.#reopen().catch(() => {});
      throw error;
    }
  }

  fabric(name) {
    return this.set({ fabric: name });
  }

  // What the service said when it opened the stream: tier, passes, folds and the like.
  get opened() {
    return this.stream.opened;
  }

  // Sends one pose, and says whether the stream took it: 24 rotation vectors [rad], translation of the root [m].
  pose(poses, trans = [0, 0, 0]) {
    return this.stream.send(flatPose(poses), trans);
  }

  // Sends one pose of the avatar's own rig: the local rotation of each of its nodes, x, y, z, w, in the order in which
  // avatars() tells them, and where the node of its pelvis is [m]; at its rest place if left out.
  rigPose(quaternions, place = []) {
    const { nodes } = this.stream.opened ?? {};
    const flat = Array.from(quaternions, (one) => (typeof one === "number" ? one : Array.from(one))).flat();
    if (nodes && flat.length === 4 * nodes) return this.stream.send(flat, place, true);
    const expected = nodes ? `${nodes} quaternions, one a node of the avatar` : "a garment that is worn by an avatar";
    const words = { name: "rigPose", expected, got: `${flat.length} numbers`, kind: "MotionError" };
    throw new DrapeError({ ...words, cure: "wear() takes avatar; avatars() tells its nodes in their order." });
  }

  // From now on poses come from source(timeS), or source.sample(timeS): { poses, trans }, or null for none this time.
  // source.begin(drape, options), if there is one, is called before and may promise options that the stream needs.
  async follow(source) {
    this.stop();
    if (!source) return;
    const { turn } = this;
    const more = await source.begin?.(this.drape, this.options);
    if (more) await this.set(more);
    if (turn !== this.turn) return; // another source came meanwhile
    const sample = typeof source === "function" ? source : (timeS) => source.sample(timeS);
    this.endSource = everyPicture((timeS) => {
      const now = sample(timeS);
      if (now) this.pose(now.poses, now.trans);
    });
  }

  // Plays a motion of the service by its name, or a document like that of GET /motions/{id}.
  async play(motion, choice) {
    this.stop();
    const { turn } = this;
    const clip = typeof motion === "string" ? await this.drape.motion(motion, this.options.betas, this.options.avatar) : motion;
    if (turn === this.turn) await this.follow(clipSource(clip, choice));
  }

  // No more poses by itself; the cloth stays as it is.
  stop() {
    this.turn += 1;
    this.endSource?.();
    this.endSource = null;
  }

  close() {
    this.stop();
    this.stream.close();
    this.decoding?.close();
    this.drape.worn.delete(this);
    this.state = "closed";
    for (const { resolve } of this.asked.splice(0)) resolve();
    this.onState("closed", null);
  }

  #turnTo(state, refusal) {
    this.state = state;
    this.begun ||= state === "open";
    // Who opens it wants to know at once; later on it comes back by itself.
    if (state !== "waiting" || !this.begun) {
      for (const { resolve, reject } of this.asked.splice(0)) {
        if (state === "open") resolve();
        else reject(refusal);
      }
    }
    this.onState(state, refusal);
  }

  // Frames wait here one at a time: a newer one takes the place of one that was not decoded yet.
  #take(frame) {
    this.stats.skipped += this.newest !== null;
    this.newest = frame;
    this.#decodeNewest();
  }

  async #decodeNewest() {
    if (this.busy || !this.decoding || !this.newest) return;
    const frame = this.newest;
    this.newest = null;
    if (frame.data === this.decoded) {
      if (this.folds) this.decoding.rest(frame.header.client_time_s);
      this.#show(frame);
      return;
    }
    this.busy = true;
    const watched = this.foldsBy === "client" ? this.pace : null;
    const begunS = performance.now() / 1000;
    watched?.begin();
    try {
      const body = this.folds && { pose: Float32Array.from(frame.pose), effort: this.stream.opened };
      const targets = await this.decoding.decode(frame.data, body);
      if (targets) {
        this.decoded = frame.data;
        this.stats.hereS = performance.now() / 1000 - begunS;
        this.positions = targets.map(({ positions }) => positions);
        this.normals = targets.map(({ normals }) => normals);
        this.#show(frame);
        if (watched?.end() && this.auto) this.#giveUpFolds();
      }
    } finally {
      this.busy = false;
    }
    this.#decodeNewest();
  }

  #show(frame) {
    if (this.state === "closed") return;
    const { header, pose, rig, bytes } = frame;
    this.root = header.root;
    if (!rig) this.bodyPose = pose;
    this.header = header;
    const { stats } = this;
    stats.frames += 1;
    stats.ageS = frame.ageS();
    stats.dropped = header.dropped;
    stats.residenceS = header.residence_us / 1e6;
    stats.bytes = bytes;
    this.onFrame(this);
  }
}
