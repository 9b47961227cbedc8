// The drawer of bodies: the service's body by a tape in centimetres, its skin, and characters of the user's.
import { TONES } from "./figure.js";
import { element, failing, make, title } from "./words.js";

const MEASURES = { height_m: "Height", chest_m: "Chest", waist_m: "Waist", hip_m: "Hip" };
const TONE_NAMES = ["Fair", "Light", "Tan", "Brown", "Deep", "Dark"];
const centimetres = (metres) => Math.round(100 * metres);

export class Measures {
  // rest: the service's REST calls; onShape(betas); onTone(tone); onCharacter(id or null).
  constructor(rest, { onShape, onTone, onCharacter }) {
    Object.assign(this, { rest, onShape, onTone, onCharacter });
    this.body = null;
    this.turn = 0;
    element("usual").addEventListener("click", failing(() => this.#reset()));
    const tones = TONES.map((tone, i) => {
      const dot = make("button", { type: "button", className: "dot", title: TONE_NAMES[i], "aria-label": `${TONE_NAMES[i]} skin`, "aria-pressed": i === 1 });
      dot.style.setProperty("--dot", tone);
      dot.addEventListener("click", () => {
        for (const other of element("tones").children) other.setAttribute("aria-pressed", other === dot);
        onTone(tone);
      });
      return dot;
    });
    element("tones").replaceChildren(...tones);
  }

  async offer(body) {
    this.body = body;
    const { measures, ranges } = await this.rest.measures(body);
    this.sliders = Object.entries(MEASURES).map(([name, words]) => {
      const { least, most } = ranges[name];
      const slider = make("input", { type: "range", id: name, min: Math.ceil(100 * least), max: Math.floor(100 * most), step: 1 });
      const told = make("output", { for: name });
      slider.addEventListener("input", () => this.#tell(slider, told));
      slider.addEventListener("change", failing(() => this.#ask()));
      const label = make("label", { className: "measure", children: [make("span", { textContent: words }), slider, told] });
      return { name, slider, told, label };
    });
    element("measures").replaceChildren(...this.sliders.map(({ label }) => label));
    this.#put(measures);
  }

  #tell(slider, told) {
    told.textContent = `${slider.value} cm`;
    slider.setAttribute("aria-valuetext", `${slider.value} centimetres`);
  }

  #put(measures) {
    for (const { name, slider, told } of this.sliders) {
      slider.value = centimetres(measures[name]);
      this.#tell(slider, told);
    }
  }

  async #ask() {
    this.turn += 1;
    const { turn } = this;
    const asked = Object.fromEntries(this.sliders.map(({ name, slider }) => [name, Number(slider.value) / 100]));
    const { betas, measures, missed } = await this.rest.shape(this.body, asked);
    if (turn !== this.turn) return;
    this.#put(measures);
    const off = Object.entries(missed).filter(([one]) => one in MEASURES);
    const words = off.map(([one, by]) => `${MEASURES[one].toLowerCase()} is ${Math.abs(centimetres(by))} cm ${by > 0 ? "more" : "less"}`);
    element("missed").textContent = words.length ? `No body has all of these: its ${words.join(", its ")}.` : "";
    await this.onShape(betas);
  }

  async #reset() {
    this.turn += 1;
    element("missed").textContent = "";
    this.#put((await this.rest.measures(this.body)).measures);
    await this.onShape([]);
  }

  // avatars: the service's list; chosen: the id of one, or null for the service's body.
  listCharacters(avatars, chosen) {
    const one = (id, name) => {
      const button = make("button", { type: "button", className: "option", textContent: name, "aria-pressed": id === chosen, "data-character": id ?? "" });
      button.addEventListener("click", () => this.onCharacter(id));
      return button;
    };
    element("characters").replaceChildren(one(null, "Our body"), ...avatars.map(({ id, name }) => one(id, title(name))));
    element("body-controls").hidden = chosen !== null;
  }
}
