// One control for how much is computed, with what it takes.
import { FLAG_STEPPED } from "../lib/src/wire.js";
import { element, make, title } from "./words.js";

const SMOOTH = 0.15; // share of a new frame in what is told

export class Quality {
  constructor({ onChange }) {
    this.onChange = onChange;
    this.ms = null;
  }

  // tiers: the service's, the least first; asked: the id of one that the address names.
  offer(tiers, asked) {
    const chosen = tiers.find(({ id }) => id === asked) ?? tiers.find((tier) => tier.default);
    const choices = tiers.map(({ id, figures }) => {
      const input = make("input", { type: "radio", name: "tier", id: `tier-${id}`, value: id, checked: id === chosen.id });
      input.addEventListener("change", () => {
        this.ms = null;
        this.onChange();
      });
      const measured = figures.cpu_ms ? `${figures.cpu_ms.toFixed(0)} ms of a core for a frame, ${figures.machine}` : "";
      return make("label", { title: measured, children: [input, make("span", { textContent: title(id) })] });
    });
    element("tiers").replaceChildren(...choices);
  }

  get tier() {
    return element("tiers").querySelector("input:checked")?.value;
  }

  choose(place) {
    element("tiers").querySelectorAll("input")[place]?.click();
  }

  // header: of a frame; told is how long the service had it, smoothed.
  take(header) {
    if (header.residence_us) {
      const ms = header.residence_us / 1000;
      this.ms = this.ms === null ? ms : this.ms + SMOOTH * (ms - this.ms);
    }
    this.less = (header.flags & FLAG_STEPPED) !== 0;
  }

  tell() {
    element("ms").textContent = this.ms === null ? "–" : `${this.ms.toFixed(0)} ms`;
    element("under-load").hidden = !this.less;
  }
}
