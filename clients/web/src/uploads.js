// Garments of the user's: from their files to the shelf, with words on the way.
import { uploadGarment } from "./service.js";
import { element, failing, say } from "./words.js";

const STAGES = { start: "begins", read: "is read", rest: "is laid on the body", fit: "gets its patches", cloth: "comes to rest", store: "is stored", prepare: "is made ready" };

export class Uploads {
  // rest(): the calls of the service; onMade(ids): garments are there, and promises when they are worn.
  constructor({ rest, onMade }) {
    Object.assign(this, { rest, onMade });
    this.take = failing((parts) => this.#take(parts));
  }

  async #take(parts) {
    const { name } = parts[0].file;
    const ending = new AbortController();
    element("cancel").hidden = false;
    element("cancel").onclick = () => ending.abort();
    try {
      const told = (job) => say(`${name} ${STAGES[job.stage] ?? "waits"} … ${Math.round(100 * job.share)} %`);
      say(`${name} is sent …`);
      const { garments, wearer, notes } = await uploadGarment(this.rest(), parts, { avatar: element("modelled-on").value }, told, ending.signal);
      await this.onMade(garments);
      const count = garments.length > 1 ? `, ${garments.length} garments over each other` : "";
      const others = notes.length ? ` ${notes.join(". ")}.` : "";
      say(`${name} is ready${count}${wearer ? `. It seems made for ${wearer.words}` : ""}.${others}`);
    } finally {
      element("cancel").hidden = true;
    }
  }
}
