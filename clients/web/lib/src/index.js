// A service whose garments are objects of three.js.
import { Drape as Core } from "./core.js";
import { Worn } from "./worn.js";

export { DrapeError, clipSource } from "./core.js";
export { Worn } from "./worn.js";

export class Drape extends Core {
  // Besides the options of a drape: body, whether the service's body is shown too; colours, one for each garment.
  async wear(garments, { body = false, colours, ...options } = {}) {
    const worn = new Worn(await super.wear(garments, options), { colours });
    return body ? worn.addBody() : worn;
  }
}

export const connect = (url, options) => new Drape(url, options).open();
