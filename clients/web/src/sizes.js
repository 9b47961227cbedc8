// The size of the selected garment, and the one that the body takes.
import { element, make } from "./words.js";

const GIRTHS = { chest_m: "chest", waist_m: "waist", hip_m: "hips", length_m: "length" };
const centimetres = (metres) => Math.round(100 * metres);

export class Sizes {
  // shelf: whose selected layer it is about; onSize(): another one is chosen. advice(id): promises the size that whoever
  // wears it takes, and why, or null where nobody can say.
  constructor(shelf, { onSize, advice }) {
    Object.assign(this, { shelf, onSize, advice });
    this.turn = 0;
  }

  // All that is worn in one size, where it comes in it.
  wear(size) {
    for (const layer of this.shelf.worn) {
      if (this.shelf.garment(layer.id).sizes.some((one) => one.size === size)) layer.size = size === "M" ? null : size;
    }
    this.shelf.tellSizes();
  }

  draw() {
    const layer = this.shelf.worn[this.shelf.selected];
    const sizes = layer ? this.shelf.garment(layer.id).sizes : [];
    element("size-part").hidden = sizes.length === 0;
    if (sizes.length === 0) return;
    element("sizes").replaceChildren(...sizes.map((one) => this.#button(one, layer)));
    this.#tell(sizes.find(({ size }) => size === sizeOf(layer)), layer);
  }

  #button(one, layer) {
    const chosen = one.size === sizeOf(layer);
    const button = make("button", { type: "button", className: "option size", textContent: one.size, title: measured(one), "data-size": one.size, "aria-pressed": chosen });
    button.addEventListener("click", () => {
      layer.size = one.size === "M" ? null : one.size;
      this.shelf.tellSizes();
      this.draw();
      element("sizes").querySelector(`[data-size="${one.size}"]`).focus();
      this.onSize();
    });
    return button;
  }

  async #tell(worn, layer) {
    this.turn += 1;
    const { turn } = this;
    element("size-measures").textContent = `${worn.size}: ${measured(worn)}.`;
    const found = await this.advice(layer.id).catch(() => null); // without it the sizes are there all the same
    if (turn !== this.turn) return;
    for (const button of element("sizes").children) {
      const taken = button.dataset.size === found?.size;
      button.classList.toggle("taken", taken);
      button.setAttribute("aria-label", taken ? `${button.dataset.size}, what this body takes` : button.dataset.size);
    }
    element("size-advice").textContent = found ? `This body takes ${found.size}: ${found.words}.` : "";
  }

  // What is asked of the service: a list by layer, or nothing where all are in M.
  option() {
    const chosen = this.shelf.worn.map(({ size }) => size);
    return chosen.some(Boolean) ? { size: chosen } : {};
  }
}

const sizeOf = (layer) => layer.size ?? "M";

// Girths and length of a size in words.
function measured(one) {
  const known = Object.entries(GIRTHS).filter(([name]) => one[name] !== null);
  return known.map(([name, word]) => `${word} ${centimetres(one[name])} cm`).join(", ");
}
