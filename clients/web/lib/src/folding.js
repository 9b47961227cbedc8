// One garment on one body, draped by the engine: vertices of jets, swing, folds, and the memory of the frame before.
import { Engine } from "./engine.js";
import { Network } from "./network.js";
import { tilesOf } from "./tiles.js";
import { unpackLayout } from "./wire.js";

const JOINTS = 24;
const PART_SIZE = 48; // samples of the skin that are posed together
const REGION_SIZE = 12;
const PAUSE_S = 0.25; // a frame that comes later has no past
const SHORTEST_STEP_S = 1 / 240; // frames that come closer together count as this far apart
const OUTCOME = { settled: 0, reset: 8, lost: 16, turn: 24, bytes: 56 }; // struct FoldOutcome of folds.hpp

// Quaternions, w first, of the joints of a pose of 72 numbers [rad].
export function quaternionsOf(pose) {
  const quaternions = new Float32Array(4 * JOINTS);
  for (let joint = 0; joint < JOINTS; joint++) {
    const [x, y, z] = pose.slice(3 * joint, 3 * joint + 3);
    const angle = Math.hypot(x, y, z);
    const share = angle < 1e-8 ? 0.5 : Math.sin(0.5 * angle) / angle;
    quaternions.set([Math.cos(0.5 * angle), share * x, share * y, share * z], 4 * joint);
  }
  return quaternions;
}

export class Folding {
  // module: the compiled engine (folds.js); constants: a FOLDS message; network: another, with the network's records, where
  // no jets come; layout: the garment's LAYOUT, null where no vertices are made of jets.
  static async make({ module, constants, network = null }, layout = null) {
    return new Folding(await Engine.make(module), constants, network, layout);
  }

  constructor(engine, constants, network, layout) {
    this.engine = engine;
    const told = engine.lay(constants);
    this.network = network && new Network(engine, network);
    this.weights = this.network?.weights ?? engine.record("Weights");
    this.#makeBody(told.BodyFeed);
    if (layout) this.#makeJets(unpackLayout(layout));
    this.#makeFolds(told);
    this.#makeSwing(told.SwingConstants);
    this.hung = told.hung;
    this.drawn = this.hung && engine.array("numbers", 3 * this.hung.kind.count);
  }

  #points(count) {
    return this.engine.array("numbers", 3 * count);
  }

  #makeBody(feed) {
    const { engine } = this;
    const numbers = (count) => engine.array("numbers", count);
    const samples = PART_SIZE * feed.skin_counts.count;
    const code = numbers(this.network?.codeSize ?? 0);
    this.local = numbers(4 * JOINTS);
    this.feed = engine.record("BodyFeed", { ...feed, local: this.local });
    this.body = engine.record("PosedBody", {
      quaternion: numbers(4 * JOINTS), rotation: numbers(9 * JOINTS), translation: numbers(3 * JOINTS), place: numbers(3 * JOINTS),
      code, betas: feed.betas, skin: numbers(8 * samples), region: numbers((4 * samples) / REGION_SIZE),
    });
  }

  #makeJets(layout) {
    const { engine } = this;
    const put = (kind, numbers) => {
      const array = engine.array(kind, numbers.length);
      engine.view(array).set(numbers);
      return array;
    };
    this.tiles = engine.record("Tiles", tilesOf(layout, put));
    const [jet, rotation, centre] = [45, 9, 3].map((width) => engine.array("numbers", width * layout.count));
    this.jets = engine.record("PosedJets", { jet, rotation, centre });
  }

  #makeFolds({ Levels: levels, FoldConstants: one }) {
    const { engine } = this;
    this.levels = levels ? engine.record("Levels", levels) : null;
    this.cloth = one ? engine.record("FoldConstants", one) : null;
    this.count = (levels?.fine ?? one).sheet.place.count; // of vertices
    this.smooth = this.#points(this.count); // the network's
    this.swung = this.#points(this.count);
    this.folded = this.#points(this.count);
    this.around = engine.record("Surroundings", { skin: this.body.skin });
    this.effort = engine.record("FoldEffort");
    this.outcome = engine.array("bytes", OUTCOME.bytes);
    const [places, fine] = [(levels?.coarse ?? one).sheet.vertex.count, levels?.fine.sheet.vertex.count ?? 0];
    // The memory of the frame before, and the one that is made.
    this.foldMemories = [0, 1].map(() => {
      const [network, residual, velocity, grip, laid] = [places, places, places, places, fine].map((count) => this.#points(count));
      const [own, other] = [0, 1].map(() => engine.array("int32s", places));
      return engine.record("FoldMemory", { network, residual, velocity, grip, own, other, fine: laid, step_s: Infinity });
    });
    this.graph = engine.record("SkinGraph", (levels?.coarse ?? one).graph);
    this.under = this.#points(places); // the network's coarse places
    this.timeS = -Infinity; // of the last folds
    this.lifted = false; // whether cloth was lifted alone then
  }

  #makeSwing(constants) {
    const { engine } = this;
    this.swing = constants ? engine.record("SwingConstants", constants) : null;
    const nodes = constants?.mesh.vertex.count ?? 0;
    this.swingMemories = [0, 1].map(() => {
      const [network, swung, speed] = [0, 1, 2].map(() => this.#points(nodes));
      const climb = engine.array("numbers", nodes);
      const [touched, origin, since] = [engine.array("int32s", nodes), engine.array("float64s", 3), engine.array("float64s", 1)];
      return engine.record("SwingMemory", { network, swung, speed, climb, touched, origin, time_s: -Infinity, still_since_s: since });
    });
    this.swungS = -Infinity; // of the last swing
  }

  // The skin's samples, 8 numbers each, in a pose of 72 numbers [rad]; good until the next call.
  skin(pose) {
    const { engine } = this;
    engine.view(this.local).set(quaternionsOf(pose));
    engine.call("pose_body", this.weights, this.feed, this.body);
    return engine.view(this.body.skin);
  }

  // Puts vertices (3 numbers each, from the root [m]) of a frame into positions. jets: { jet, rotation, centre } of it, or
  // null where the network is here. pose: 72 numbers [rad]; root: its place [m]; steps: of folds; effort: what the service
  // said of its opening.
  drape(jets, positions, { pose, root, timeS, steps, effort }) {
    const { engine } = this;
    this.skin(pose);
    if (jets) for (const name of ["jet", "rotation", "centre"]) engine.view(this.jets[name]).set(jets[name]);
    else this.network.run(this.body, this.jets, effort.passes);
    engine.call("vertices", this.jets, this.tiles, this.smooth, BigInt(this.count));
    positions.set(engine.view(this.drawnOn(this.moved(root, timeS, steps, effort))));
  }

  // The array of what is drawn where the cloth is: the mesh that hangs on it, or itself.
  drawnOn(cloth) {
    if (!this.hung) return cloth;
    const { faces, asked, corner, weight, offset, kind } = this.hung;
    const counted = [cloth, BigInt(this.count), faces, BigInt(faces.count / 3), asked, BigInt(asked.count)];
    this.engine.call("draw_bound", ...counted, corner, weight, offset, kind, BigInt(kind.count), this.drawn);
    return this.drawn;
  }

  // The array of the network's vertices with swing and folds.
  moved(root, timeS, steps, effort) {
    const { motion, inertia, coarse } = effort;
    const swung = this.swing && motion && inertia === "mesh" ? this.swingOn(root, timeS, motion) : this.smooth;
    if (!steps && !coarse) return swung;
    this.fold(swung, timeS, steps, effort);
    return this.folded;
  }

  // The array of the network's vertices with a share of their swing.
  swingOn(root, timeS, share) {
    const { engine } = this;
    const [past, after] = this.swingMemories;
    engine.view(after.origin).set(root);
    engine.set(after, { time_s: timeS });
    const moved = engine.call("swing", this.smooth, BigInt(this.count), past, this.around, this.swing, share, after, this.swung);
    [this.swingMemories, this.swungS] = [[after, past], timeS];
    return moved ? this.swung : this.smooth;
  }

  // Folds vertices into this.folded; returns what became of them. The skin is as it was posed last.
  fold(vertices, timeS, steps, { settle, cloth_contact: contact, clearance_m: clearanceM }) {
    const { engine } = this;
    if (this.lifted && steps) this.#unfold(vertices);
    const alone = this.levels !== null && !steps && (this.lifted || this.timeS === -Infinity); // folds that fade go on
    const [past, after] = this.foldMemories;
    const sinceS = timeS - this.timeS;
    const follows = sinceS >= 0 && sinceS <= PAUSE_S;
    engine.set(after, { fine: after.fine }); // which a lift leaves out
    engine.set(past, { step_s: follows ? Math.max(sinceS, SHORTEST_STEP_S) : Infinity });
    engine.set(this.effort, { steps, settle, cloth_contact: Number(contact), clearance_m: clearanceM });
    const [name, cloth] = this.levels ? [alone ? "lift_alone" : "fold_two_levels", this.levels] : ["fold", this.cloth];
    engine.call(name, vertices, past, this.around, cloth, this.effort, after, this.folded, this.outcome);
    const told = new DataView(engine.memory.buffer, this.outcome.at);
    const [settled, reset, lost, turn] = ["settled", "reset", "lost", "turn"].map((field) => Number(told.getBigInt64(OUTCOME[field], true)));
    engine.set(after, { turn });
    this.foldMemories = [after, past];
    [this.timeS, this.lifted] = [timeS, alone];
    return { settled, reset, lost };
  }

  // Makes of the memory of a lift one of folds: nothing moves, and the skin holds each place where the network has it now.
  #unfold(vertices) {
    const { engine, under } = this;
    const [{ own, other, velocity, grip }] = this.foldMemories;
    const [from, to, kept] = [vertices, under, this.levels.kept].map((array) => engine.view(array));
    kept.forEach((vertex, place) => to.set(from.subarray(3 * vertex, 3 * vertex + 3), 3 * place));
    engine.view(other).fill(-1);
    engine.view(velocity).fill(0);
    const { skin } = this.around;
    engine.call("write_grip", under, BigInt(kept.length), under, own, skin, BigInt(skin.count / 8), this.graph, grip);
    engine.set(this.foldMemories[0], { turn: 0, fine: null });
    this.lifted = false;
  }

  // The cloth hangs still, and is as old as it was at the time [s].
  rest(timeS) {
    if (this.timeS > -Infinity) this.timeS = timeS;
    if (this.swungS > -Infinity) this.engine.set(this.swingMemories[0], { time_s: timeS });
  }
}
