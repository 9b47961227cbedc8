// Garments of the user's: from their files to the shelf, with words on the way, and again for another wearer.
import { removeGarment, uploadGarment } from "./service.js";
import { WearerCard } from "./wearer.js";
import { element, failing, say } from "./words.js";

const STAGES = { start: "begins", read: "is read", rest: "is laid on the body", fit: "gets its patches", cloth: "comes to rest", store: "is stored", prepare: "is made ready" };
const TOLD = 2; // notes of a garment that are said

export class Uploads {
  // rest(): the calls of the service; onMade(ids, instead): garments are there, in the place of the garments instead, and
  // promises when they are worn.
  constructor({ rest, onMade }) {
    Object.assign(this, { rest, onMade });
    this.card = new WearerCard({ onChoose: failing((upload, options) => this.#make(upload.parts, options, upload)) });
    this.take = failing((parts) => this.#make(parts, { avatar: element("modelled-on").value }));
  }

  // before: the upload that this one takes the place of.
  async #make(parts, options, before = null) {
    const { name } = parts[0].file;
    const ending = new AbortController();
    element("cancel").hidden = false;
    element("cancel").onclick = () => ending.abort();
    this.card.show(false);
    try {
      const told = (job) => say(`${name} ${STAGES[job.stage] ?? "waits"} … ${Math.round(100 * job.share)} %`);
      say(`${name} is sent …`);
      const job = await uploadGarment(this.rest(), parts, options, told, ending.signal);
      const old = (before?.garments ?? []).filter((id) => !job.garments.includes(id));
      await this.onMade(job.garments, old);
      for (const id of old) await removeGarment(this.rest(), id);
      this.card.tell({ name, parts, garments: job.garments, wearer: job.wearer ?? before?.wearer ?? null, said: job.wearer ? "" : options.avatar });
      say(`${name} is ready${this.#words(job)}`);
    } catch (error) {
      // Whoever knows its wearer can say so.
      if (/\b(avatar|unit)\b/.test(error.cure ?? "")) this.card.tell({ wearer: null, garments: [], ...before, name, parts, said: "" }, { asked: true });
      throw error;
    } finally {
      element("cancel").hidden = true;
    }
  }

  #words({ garments, notes }) {
    const count = garments.length > 1 ? `, ${garments.length} garments over each other` : "";
    const more = notes.length > TOLD ? ` And ${notes.length - TOLD} notes more.` : "";
    return `${count}.${notes.slice(0, TOLD).map((note) => ` ${note[0].toUpperCase()}${note.slice(1)}.`).join("")}${more}`;
  }
}
