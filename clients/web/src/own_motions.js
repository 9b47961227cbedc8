// Motions of files that were dropped. The service reads them; they last for this visit.
import { aboutGlb } from "./scene_file.js";
import { hush, say } from "./words.js";

export class OwnMotions {
  // motions: the list that they join; rest(): the calls of the service.
  constructor(motions, rest) {
    Object.assign(this, { motions, rest });
    this.own = new Map(); // by id: { name, file, clip, read }
    this.count = 0;
  }

  has(id) {
    return this.own.has(id);
  }

  // The clip as Motions takes it, on the ground for body: { joints, floor_m }.
  async load(id, body) {
    const one = this.own.get(id);
    const { askMotion, placed } = await import("./motion_file.js");
    if (!one.read) say(`${one.file.name} is read …`, { by: id });
    one.read ??= askMotion(this.rest(), one.file, one.clip);
    one.read.then(() => hush(id), () => (one.read = null));
    return { ...placed(await one.read, body), id };
  }

  // Puts the clips of a file into the list, the first of them at once; one that cannot be read leaves the list as it was.
  async take(file) {
    const before = this.motions.wanted;
    const [first, ...more] = this.#put(file, await clipsOf(file));
    await this.motions.choose(first);
    if (this.own.get(first).read) return;
    for (const id of [first, ...more]) this.own.delete(id); // why was said
    const { wanted, clip } = this.motions;
    const next = [first, clip?.id].includes(wanted) ? before : wanted; // unless another was chosen meanwhile
    this.motions.offer(this.motions.clips.filter(({ id }) => !id.startsWith("own-") || this.own.has(id)), next);
    await this.motions.choose(next);
  }

  // Puts the clips that a character's file has into the list.
  async offer(file) {
    if ((await aboutGlb(file)).clips.length) this.#put(file, await clipsOf(file));
  }

  // clips: { name, clip } of each; their ids.
  #put(file, clips) {
    const fresh = clips.map((one) => ({ ...one, file, read: null, id: `own-${++this.count}` }));
    for (const one of fresh) this.own.set(one.id, one);
    this.motions.offer([...this.motions.clips, ...fresh.map(({ id, name }) => ({ id, name }))], this.motions.wanted);
    return fresh.map(({ id }) => id);
  }
}

// Those of several are told by their names; of one alone the file's name says what it is.
async function clipsOf(file) {
  const names = (await aboutGlb(file)).clips.filter(Boolean);
  if (names.length > 1) return [...new Set(names)].map((name) => ({ name, clip: name }));
  return [{ name: file.name.replace(/\.\w+$/, ""), clip: null }];
}
