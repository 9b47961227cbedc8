// A service whose garments are objects of three.js.
import { Drape as Core } from "./core.js";
import { readBody } from "./body.js";
import { fabricLook } from "./materials.js";
import { Worn } from "./worn.js";

export { DrapeError, clipSource, landmarkSource } from "./core.js";
export { Worn } from "./worn.js";

export class Drape extends Core {
  // Besides the options of a drape: body, whether the service's body is shown too; colours, one for each garment; plain,
  // whether cloth is to be cheap to draw; cover, whether the skin of an avatar's rig that it follows is drawn deeper below it.
  async wear(garments, { body = false, colours, plain, cover: covers, ...options } = {}) {
    const opening = super.wear(garments, options);
    const looks = this.#looksOf([garments].flat());
    try {
      const [wearing, figure] = await Promise.all([opening, body ? this.#figure(options.betas) : null, looks()]);
      return await new Worn(wearing, { colours, figure, looks: (fabric) => looks(wearing, fabric), plain, covers }).dress();
    } catch (error) {
      opening.then((wearing) => wearing.close(), () => {}); // its own failure is the error already
      throw error;
    }
  }

  // Asked once.
  fabrics() {
    this.fabricsKept ??= super.fabrics();
    this.fabricsKept.catch(() => (this.fabricsKept = null));
    return this.fabricsKept;
  }

  // A function that promises how what is worn looks, in the option fabric of a drape or, where that leaves it open, in its
  // own. What it asks is asked once: of these garments with its first call.
  #looksOf(named) {
    const asked = new Map();
    const told = (id) => asked.get(id) ?? asked.set(id, this.rest.garment(id)).get(id);
    return async ({ garments, layers } = { garments: named, layers: [] }, fabric = null) => {
      const [fabrics, ...own] = await Promise.all([this.fabrics(), ...garments.map(told)]);
      return layers.map(({ id }) => {
        const at = garments.indexOf(id);
        const made = (Array.isArray(fabric) ? fabric[at] : fabric) ?? own[at].fabric;
        return fabricLook(typeof made === "string" ? fabrics.find((one) => one.id === made) : made);
      });
    };
  }

  async #figure(betas) {
    return readBody(await this.rest.bodyFile(this.health.body, betas));
  }
}

export const connect = (url, options) => new Drape(url, options).open();
