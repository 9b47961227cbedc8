// The drawer of fabrics: of what the selected garment is made, and its colour.
import { fabricLook, fabricSwatch } from "../lib/src/materials.js";
import { element, make, title } from "./words.js";

const SWATCH_PX = 112;
const SWATCH_M = 0.008; // of cloth across a swatch
const COLOURS = {
  Ink: "#2b313c", Slate: "#5b6673", Bone: "#d9d2c5", Sand: "#b59d7c", Clay: "#a4573f", Wine: "#6e2b36",
  Moss: "#5f6b4c", Petrol: "#1f5560", Sky: "#8fb0cc", Rose: "#cf9a97", Mustard: "#c69a3b", White: "#f1efea",
};

export class Fabrics {
  // shelf: whose selected layer it is about; onFabric(): another one is chosen.
  constructor(shelf, { onFabric }) {
    this.shelf = shelf;
    this.onFabric = onFabric;
    this.list = [];
    this.free = true;
    new MutationObserver(() => this.draw()).observe(element("drawer-fabric"), { attributeFilter: ["hidden"] });
    element("further-in").addEventListener("click", () => shelf.move(-1));
    element("further-out").addEventListener("click", () => shelf.move(1));
    const dots = Object.entries(COLOURS).map(([name, colour]) => {
      const dot = make("button", { type: "button", className: "dot", title: name, "aria-label": name, "data-colour": colour });
      dot.style.setProperty("--dot", colour);
      dot.addEventListener("click", () => {
        if (shelf.worn.length) shelf.setColour(shelf.selected, colour);
        this.draw();
      });
      return dot;
    });
    element("dyes").replaceChildren(...dots);
  }

  // list: the service's fabrics; free: whether its model drapes by them.
  offer(list, free) {
    this.list = list;
    this.free = free;
    element("fabric-note").hidden = free;
    this.draw();
  }

  draw() {
    const { worn, selected } = this.shelf;
    const layer = worn[selected];
    if (!layer) return;
    const garment = this.shelf.garment(layer.id);
    element("fabric-of").textContent = title(garment.name);
    const alone = worn.length === 1;
    element("order-row").hidden = alone;
    element("order").textContent = selected === 0 ? "innermost" : selected === worn.length - 1 ? "outermost" : `layer ${selected + 1}`;
    element("further-in").disabled = selected === 0;
    element("further-out").disabled = selected === worn.length - 1;
    for (const dot of element("dyes").children) dot.setAttribute("aria-pressed", dot.dataset.colour === layer.colour);
    const own = typeof garment.fabric === "string" ? garment.fabric : null;
    if (element("drawer-fabric").hidden) return; // swatches are drawn for who looks at them
    const swatches = this.list.map((fabric) => this.#swatch(fabric, layer, own));
    element("swatches").replaceChildren(...swatches);
  }

  #swatch(fabric, layer, own) {
    const look = fabricLook(fabric);
    const canvas = make("canvas", { width: SWATCH_PX, height: SWATCH_PX, "aria-hidden": "true" });
    const pixels = fabricSwatch(look, layer.colour, SWATCH_PX, SWATCH_M / look.pitchM);
    canvas.getContext("2d").putImageData(new ImageData(pixels, SWATCH_PX, SWATCH_PX), 0, 0);
    const kind = `${(1000 * fabric.density_kg_m2).toFixed(0)} g/m², ${look.knit ? "knit" : "woven"}`;
    const words = make("span", { className: "words", children: [make("b", { textContent: title(fabric.id) }), make("small", { textContent: fabric.id === own ? "its own" : kind })] });
    const chosen = (layer.fabric ?? own) === fabric.id;
    const swatch = make("button", { type: "button", className: "swatch", "data-fabric": fabric.id, "aria-pressed": chosen, children: [canvas, words] });
    swatch.title = `${title(fabric.id)}: ${kind}`;
    swatch.disabled = !this.free;
    swatch.addEventListener("click", () => {
      layer.fabric = fabric.id === own ? null : fabric.id;
      this.draw();
      element("swatches").querySelector(`[data-fabric="${fabric.id}"]`).focus();
      this.onFabric();
    });
    return swatch;
  }

  // The option of a drape: a name or a list by layer; nothing where each garment is of its own.
  option() {
    const chosen = this.shelf.worn.map(({ fabric }) => fabric);
    return this.free && chosen.some(Boolean) ? { fabric: chosen } : {};
  }
}
