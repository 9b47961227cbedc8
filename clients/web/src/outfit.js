// What is worn now: one object of the library at a time; the next one takes its place with its first frame.
export class Outfit {
  // onFrame(worn): its vertices have moved; onState(state, refusal): what the stream does; onFolds({ tookS, allowedS }):
  // this device was too slow for folds, and the service makes them.
  // onOpen(worn): promises that what lies below it is ready too.
  constructor(drape, stage, { onFrame, onState, onFolds, onOpen }) {
    this.onOpen = onOpen;
    this.drape = drape;
    this.stage = stage;
    this.onFrame = onFrame;
    this.onState = onState;
    this.onFolds = onFolds;
    this.current = null;
    this.next = null;
    this.coming = null; // the next one, while it is made ready to be drawn: no frames of it are asked for
    this.asked = "";
    this.turn = 0;
  }

  // Wears layers, { id, colour } of each, the innermost first, by options of a drape. What changes neither garments nor
  // meshes goes on in the same stream. Promises whether this is still what is wanted when it is open.
  async wear(layers, options, meshed) {
    const ids = layers.map(({ id }) => id);
    const asked = JSON.stringify([ids, meshed]);
    const latest = this.next ?? this.current;
    this.turn += 1;
    const { turn } = this;
    if (latest && asked === this.asked) {
      const wanted = { ...options, ...meshed };
      await latest.set({ ...forgotten(latest.wearing.options, wanted), ...wanted });
      return turn === this.turn;
    }
    this.asked = asked;
    let made;
    try {
      made = await this.drape.wear(ids, { ...options, ...meshed, plain: this.stage.plain });
    } catch (error) {
      if (turn !== this.turn) return false;
      this.asked = "";
      throw error;
    }
    if (turn !== this.turn) {
      made.dispose();
      return false;
    }
    this.next?.dispose();
    this.next = made;
    for (const { id, colour } of layers) dye(made, id, colour); // it may have been dyed meanwhile, and own clothes lie between
    made.setPlain(this.stage.plain);
    made.addEventListener("frame", () => this.#shown(made));
    made.addEventListener("folds", (event) => made === (this.next ?? this.current) && this.onFolds(event));
    made.addEventListener("state", ({ state, error }) => {
      if (made === (this.next ?? this.current)) this.onState(state, error);
    });
    this.onState("open", null);
    made.ready = this.onOpen(made);
    return true;
  }

  async #shown(worn) {
    if (worn === this.next) {
      if (this.coming === worn) return;
      this.coming = worn;
      await Promise.all([this.stage.ready(worn), worn.ready]);
      if (this.coming === worn) this.coming = null;
      if (worn !== this.next) return; // another one is wanted meanwhile
      this.current?.dispose();
      [this.current, this.next] = [worn, null];
      this.stage.scene.add(worn);
    }
    if (worn === this.current) this.onFrame(worn);
  }

  pose(poses, trans) {
    const sent = [this.current, this.coming ? null : this.next].map((worn) => worn?.pose(poses, trans));
    return sent.some(Boolean);
  }

  // Asks again now for what a lost service did not answer.
  retry() {
    return (this.next ?? this.current)?.set({});
  }

  colour(id, colour) {
    for (const worn of [this.current, this.next]) if (worn) dye(worn, id, colour);
    this.stage.dirty = true;
  }

  setPlain() {
    for (const worn of [this.current, this.next]) worn?.setPlain(true);
  }
}

function dye(worn, id, colour) {
  const layer = worn.wearing.layers.findIndex((one) => one.id === id);
  if (layer >= 0) worn.colour(layer, colour);
}

// Options that were named before and are not now are left to the service.
const forgotten = (before, now) => Object.fromEntries(Object.keys(before).filter((name) => !(name in now)).map((name) => [name, undefined]));
