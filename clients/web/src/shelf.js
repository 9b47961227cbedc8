// The shelf of garments, and what is worn of it, the innermost first: cards and chips.
import { element, make, say, title } from "./words.js";

export const DYES = ["#55606f", "#dad5cb", "#9a5544", "#6d7f8a"]; // slate, bone, brick, steel: of layers
const PREVIEW_PX = 256;

export class Shelf {
  // onChange(): other garments or another order; onColour(id, colour); onSelect(): another layer is looked at.
  // picture(garment): promises the address of its preview.
  constructor({ onChange, onColour, onSelect, picture }) {
    Object.assign(this, { onChange, onColour, onSelect, picture });
    this.garments = [];
    this.worn = []; // { id, colour, fabric, size }: null, its own, and M
    this.selected = 0;
    this.limit = 1;
    this.least = 1; // none has to be worn beside a character's own clothes
  }

  // garments: the service's list; ids: what is worn of it, the innermost first; limit: layers that the service takes.
  offer(garments, ids, limit = this.limit) {
    this.garments = garments;
    this.limit = limit;
    this.worn = ids.map((id, layer) => this.worn.find((one) => one.id === id) ?? this.#layer(id, layer));
    this.selected = Math.max(0, this.worn.length - 1);
    this.#drawCards();
    this.#draw();
  }

  #layer(id, layer) {
    return { id, colour: DYES[layer % DYES.length], fabric: null, size: null };
  }

  garment(id) {
    return this.garments.find((one) => one.id === id);
  }

  // Puts a garment on over all others, or takes it off.
  toggle(id) {
    const at = this.worn.findIndex((one) => one.id === id);
    if (at >= 0) {
      this.takeOff(at);
      return;
    }
    if (this.worn.length >= this.limit) {
      if (this.limit > 1) {
        say(`${this.limit} garments over each other are what this service drapes. Take one off first.`, { bad: true });
        return;
      }
      this.worn = [];
    }
    this.worn.push(this.#layer(id, this.worn.length));
    this.#changed(this.worn.length - 1);
  }

  takeOff(layer) {
    if (this.worn.length === this.least) return;
    this.worn.splice(layer, 1);
    this.#changed(Math.max(0, Math.min(this.selected, this.worn.length - 1)));
  }

  // Takes all off (0), or puts on what was worn before where nothing is (1).
  undress(least) {
    if (least === this.least) return;
    this.least = least;
    if (least === 0) [this.before, this.worn] = [this.worn, []];
    else if (!this.worn.length) this.worn = this.before;
    this.selected = Math.max(0, this.worn.length - 1);
    this.#draw();
    this.onSelect();
  }

  // Wears the selected layer further out (1) or further in (-1).
  move(way) {
    const to = this.selected + way;
    if (to < 0 || to >= this.worn.length) return;
    [this.worn[this.selected], this.worn[to]] = [this.worn[to], this.worn[this.selected]];
    this.#changed(to);
  }

  select(layer) {
    this.selected = layer;
    this.#draw();
    this.onSelect();
  }

  setColour(layer, colour) {
    this.worn[layer].colour = colour;
    const dot = element(layer ? `colour-${layer}` : "colour");
    if (dot.value !== colour) dot.value = colour;
    this.onColour(this.worn[layer].id, colour);
  }

  #changed(selected) {
    this.selected = selected;
    this.#draw();
    this.onSelect();
    this.onChange();
  }

  #drawCards() {
    const cards = this.garments.map((garment) => {
      const picture = make("img", { alt: "", width: PREVIEW_PX, height: PREVIEW_PX, loading: "lazy", decoding: "async" });
      this.picture(garment, PREVIEW_PX).then((address) => (picture.src = address), () => picture.classList.add("missing"));
      const own = garment.source === "user" ? "yours" : typeof garment.fabric === "string" ? title(garment.fabric).toLowerCase() : "own fabric";
      const sizes = garment.sizes.length ? `, ${garment.sizes[0].size} to ${garment.sizes.at(-1).size}` : "";
      const words = make("span", { className: "words", children: [make("b", { textContent: title(garment.name) }), make("small", { textContent: own + sizes })] });
      const place = make("span", { className: "place", "aria-hidden": "true" });
      const card = make("button", { type: "button", className: "card", "data-garment": garment.id, children: [picture, words, place] });
      card.addEventListener("click", () => this.toggle(garment.id));
      return card;
    });
    element("cards").replaceChildren(...cards, element("own-card"));
  }

  #draw() {
    for (const card of element("cards").querySelectorAll("[data-garment]")) {
      const layer = this.worn.findIndex(({ id }) => id === card.dataset.garment);
      card.setAttribute("aria-pressed", layer >= 0);
      card.querySelector(".place").textContent = layer >= 0 ? layer + 1 : "";
    }
    element("worn").replaceChildren(...this.worn.map((one, layer) => this.#chip(one, layer)));
  }

  // Says the sizes of what is worn.
  tellSizes() {
    this.#draw();
  }

  #chip({ id, colour, size }, layer) {
    const name = title(this.garment(id).name);
    const suffix = layer ? `-${layer}` : "";
    const dot = make("input", { type: "color", id: `colour${suffix}`, value: colour, "aria-label": `Colour of ${name}` });
    dot.addEventListener("input", () => this.setColour(layer, dot.value));
    const pick = make("button", { type: "button", className: "pick", textContent: size ? `${name} ${size}` : name, "aria-pressed": layer === this.selected });
    pick.addEventListener("click", () => {
      this.select(layer);
      element("tab-fabric").click();
    });
    const off = make("button", { type: "button", className: "off", id: `remove${suffix}`, textContent: "×", "aria-label": `Take ${name} off` });
    off.disabled = this.worn.length === this.least;
    off.addEventListener("click", () => this.takeOff(layer));
    return make("li", { className: "chip", "data-garment": id, children: [dot, pick, off] });
  }
}
