// The clothes that a character came in: whether they move as cloth, and why others of its stay as they are.
import { element, listed, make, title } from "./words.js";

export class OwnClothes {
  // onChange(on): they are to move, or to stay on the skin.
  constructor({ onChange }) {
    this.box = element("alive");
    this.box.addEventListener("change", () => onChange(this.box.checked));
  }

  // about: GET /avatars/{id}; null, and one without clothes that can move: nobody is asked.
  offer(about, on) {
    const moving = about?.alive ?? [];
    this.box.checked = on && moving.length > 0;
    element("own-clothes").hidden = moving.length === 0;
    element("alive-words").textContent = `${title(listed(moving.map(({ kind }) => kind)))} of ${title(about?.name ?? "")}.`;
    const stiff = Object.entries(about?.stiff ?? {});
    element("stiff").hidden = stiff.length === 0;
    element("stiff-parts").replaceChildren(...stiff.map(([part, why]) => make("li", { children: [make("b", { textContent: part }), `: ${why}`] })));
  }

  // What is asked of the service: that they are worn.
  option() {
    return this.box.checked ? { alive: true } : {};
  }
}
