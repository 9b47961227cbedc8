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
    try {
      const [wearing, figure] = await Promise.all([opening, body ? this.#figure(options.betas) : null]);
      const looks = (fabric) => this.#looks(wearing, fabric);
      return await new Worn(wearing, { colours, figure, looks, plain, covers }).dress();
    } catch (error) {
      opening.then((wearing) => wearing.close(), () => {}); // its own failure is the error already
      throw error;
    }
  }

  // How each layer looks that is shown. fabric: the option; what it leaves open is the garment's own.
  async #looks({ garments, layers }, fabric) {
    this.fabricsKept ??= this.fabrics();
    this.fabricsKept.catch(() => (this.fabricsKept = null));
    const fabrics = await this.fabricsKept;
    const found = layers.map(async ({ id }) => {
      const asked = Array.isArray(fabric) ? fabric[garments.indexOf(id)] : fabric;
      const made = asked ?? (await this.rest.garment(id)).fabric;
      return fabricLook(typeof made === "string" ? fabrics.find((one) => one.id === made) : made);
    });
    return Promise.all(found);
  }

  async #figure(betas) {
    return readBody(await this.rest.bodyFile(this.health.body, betas));
  }
}

export const connect = (url, options) => new Drape(url, options).open();
