// Which garments are worn over each other, the innermost first: a row of controls for each.
const COLOURS = ["#66656b", "#969c8c", "#8a6a5a", "#6f7f8f"]; // charcoal, sage, clay, steel

export class Wardrobe {
  // onChange(): other garments or another order; onColour(layer, colour).
  constructor(list, addButton, { onChange, onColour }) {
    this.list = list;
    this.addButton = addButton;
    this.onChange = onChange;
    this.onColour = onColour;
    this.garments = [];
    this.limit = 1;
    addButton.addEventListener("click", () => this.#add());
  }

  // garments: the service's list; ids: what to wear of it, or what was worn; limit: layers that the service takes.
  offer(garments, ids, limit = this.limit) {
    this.garments = garments;
    this.limit = limit;
    const known = new Set(garments.map((garment) => garment.id));
    const kept = [...new Set(ids)].filter((id) => known.has(id)).slice(0, limit);
    const worn = kept.length ? kept : garments.slice(0, 1).map((garment) => garment.id);
    const colours = this.colours();
    this.list.replaceChildren(...worn.map((id, layer) => this.#row(id, colours[layer] ?? COLOURS[layer % COLOURS.length])));
    this.#tidy();
  }

  chosen() {
    return Array.from(this.list.querySelectorAll("select"), (select) => select.value);
  }

  colours() {
    return Array.from(this.list.querySelectorAll("input"), (input) => input.value);
  }

  #add() {
    const worn = new Set(this.chosen());
    const free = this.garments.find((garment) => !worn.has(garment.id));
    if (!free || worn.size >= this.limit) return;
    this.list.append(this.#row(free.id, COLOURS[worn.size % COLOURS.length]));
    this.#changed();
  }

  #row(id, colour) {
    const select = document.createElement("select");
    const names = this.garments.map((g) => new Option(g.source === "user" ? `${g.name} (yours)` : g.name, g.id));
    select.replaceChildren(...names);
    select.value = id;
    select.addEventListener("change", () => this.#changed());
    const paint = Object.assign(document.createElement("input"), { type: "color", value: colour });
    const row = document.createElement("div");
    paint.addEventListener("input", () => this.onColour([...this.list.children].indexOf(row), paint.value));
    const remove = Object.assign(document.createElement("button"), { type: "button", textContent: "×", title: "Take it off" });
    remove.addEventListener("click", () => {
      row.remove();
      this.#changed();
    });
    row.className = "layer";
    row.append(select, paint, remove);
    return row;
  }

  #changed() {
    this.#tidy();
    this.onChange();
  }

  // Names for each row's controls; a garment that is worn already cannot be chosen again.
  #tidy() {
    const rows = [...this.list.children];
    const worn = this.chosen();
    rows.forEach((row, layer) => {
      const [select, paint, remove] = row.children;
      const suffix = layer ? `-${layer}` : "";
      select.id = `garment${suffix}`;
      paint.id = `colour${suffix}`;
      remove.id = `remove${suffix}`;
      const place = rows.length === 1 ? "Garment" : layer === 0 ? "Innermost garment" : `Garment ${layer + 1}, over it`;
      select.setAttribute("aria-label", place);
      paint.setAttribute("aria-label", `${place}: colour`);
      remove.setAttribute("aria-label", `${place}: take it off`);
      remove.disabled = rows.length === 1;
      for (const option of select.options) option.disabled = worn.includes(option.value) && option.value !== select.value;
    });
    this.addButton.disabled = rows.length >= Math.min(this.limit, this.garments.length);
  }
}
