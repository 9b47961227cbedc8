// A service whose garments are objects of three.js.
import { Drape as Core } from "./core.js";
import { readBody } from "./body.js";
import { Worn } from "./worn.js";

export { DrapeError, clipSource } from "./core.js";
export { Worn } from "./worn.js";

export class Drape extends Core {
  // Besides the options of a drape: body, whether the service's body is shown too; colours, one for each garment.
  async wear(garments, { body = false, colours, ...options } = {}) {
    const opening = super.wear(garments, options);
    try {
      const [wearing, figure] = await Promise.all([opening, body ? this.#figure(options.betas) : null]);
      return new Worn(wearing, { colours, figure });
    } catch (error) {
      opening.then((wearing) => wearing.close(), () => {}); // its own failure is the error already
      throw error;
    }
  }

  async #figure(betas) {
    return readBody(await this.rest.bodyFile(this.health.body, betas));
  }
}

export const connect = (url, options) => new Drape(url, options).open();
