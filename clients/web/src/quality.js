// One control for how much is computed, with what it takes.
import { FLAG_STEPPED } from "../lib/src/wire.js";
import { element, make, title } from "./words.js";

const SMOOTH = 0.15; // share of a new frame in what is told

export class Quality {
  // onChange(): another tier; onFolds(): another place where folds are made.
  constructor({ onChange, onFolds }) {
    this.onChange = onChange;
    this.ms = this.hereMs = null;
    element("folds-by").addEventListener("change", () => {
      this.ms = this.hereMs = null;
      onFolds();
    });
  }

  // tiers: the service's, the least first; asked: the id of one that the address names, and where it wants its folds.
  offer(tiers, asked, foldsBy) {
    const places = [...element("folds-by").options].map(({ value }) => value);
    if (places.includes(foldsBy)) element("folds-by").value = foldsBy;
    const chosen = tiers.find(({ id }) => id === asked) ?? tiers.find((tier) => tier.default);
    const choices = tiers.map(({ id, figures }) => {
      const input = make("input", { type: "radio", name: "tier", id: `tier-${id}`, value: id, checked: id === chosen.id });
      input.addEventListener("change", () => {
        this.ms = this.hereMs = null;
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

  // Where folds are made, as it is asked of a stream: nothing where the service does as ever.
  get folds() {
    const by = element("folds-by").value;
    return by === "server" ? {} : { folds_by: by };
  }

  choose(place) {
    element("tiers").querySelectorAll("input")[place]?.click();
  }

  // What a frame took is told smoothed: how long the service had it, and this device where it makes the folds.
  take({ header, stats, foldsBy }) {
    const smoothed = (before, ms) => (before === null ? ms : before + SMOOTH * (ms - before));
    if (header.residence_us) this.ms = smoothed(this.ms, header.residence_us / 1000);
    this.hereMs = foldsBy === "client" ? smoothed(this.hereMs, 1000 * stats.hereS) : null;
    this.less = (header.flags & FLAG_STEPPED) !== 0;
  }

  tell() {
    element("ms").textContent = this.ms === null ? "–" : `${this.ms.toFixed(0)} ms`;
    element("under-load").hidden = !this.less;
    element("here").hidden = this.hereMs === null;
    if (this.hereMs !== null) element("here-ms").textContent = `${this.hereMs.toFixed(0)} ms`;
  }
}
