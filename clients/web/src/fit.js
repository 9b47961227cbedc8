// Fit: where a garment is tight, in colours on the cloth and in words.
import { BufferAttribute, Color, DoubleSide, MeshLambertMaterial } from "three";
import { element, make, title } from "./words.js";

const MOST = 0.1; // strain of the last colour
const SCALE = ["#3f6fb5", "#c9d6df", "#e8c65c", "#d9622b", "#9d1c2b"].map((colour) => new Color(colour)); // slack to tight

function colourOf(strain, target, at) {
  const place = Math.min(0.9999, Math.max(0, (strain + 0.25 * MOST) / (1.25 * MOST))) * (SCALE.length - 1);
  const step = Math.floor(place);
  SCALE[step].clone().lerp(SCALE[step + 1], place - step).toArray(target, at);
}

export class Fit {
  // rest: the service's REST calls; request(layer): what to ask about it.
  constructor(rest, stage, { request, name }) {
    Object.assign(this, { rest, stage, request, name });
    this.on = false;
    this.turn = 0;
    this.painted = []; // meshes and the materials that they had
  }

  // Shows or ends it for what is worn now.
  async show(worn, on) {
    this.on = on;
    this.turn += 1;
    const { turn } = this;
    this.wash();
    element("fit").setAttribute("aria-pressed", on);
    element("fit-card").hidden = !on;
    if (!on || !worn) return;
    element("fit-words").replaceChildren(make("li", { textContent: "Measuring …" }));
    const layers = worn.wearing.layers.map(({ id }) => id);
    const reports = await Promise.all(layers.map((id) => this.rest.fit(id, { ...this.request(id), vertices: true })));
    if (turn !== this.turn) return;
    worn.meshes.forEach((mesh, i) => this.#paint(mesh, worn.wearing.layers[i], reports[i]));
    const said = reports.flatMap(({ words }, i) => words.map((one) => (layers.length > 1 ? `${this.name(layers[i])}: ${one}` : title(one))));
    const lines = said.length ? said : ["Nothing is tight or loose."];
    element("fit-words").replaceChildren(...lines.map((textContent) => make("li", { textContent })));
  }

  #paint(mesh, { vertexCount, copies }, { warp, weft }) {
    if (warp.length !== vertexCount) return; // of another mesh
    const colours = new Float32Array(3 * (vertexCount + copies.length));
    for (let vertex = 0; vertex < vertexCount; vertex++) colourOf(Math.max(warp[vertex], weft[vertex]), colours, 3 * vertex);
    copies.forEach((vertex, i) => colours.copyWithin(3 * (vertexCount + i), 3 * vertex, 3 * vertex + 3));
    mesh.geometry.setAttribute("color", new BufferAttribute(colours, 3));
    this.painted.push({ mesh, material: mesh.material });
    mesh.material = new MeshLambertMaterial({ vertexColors: true, side: DoubleSide });
    this.stage.dirty = true;
  }

  // Gives the cloth its own look again.
  wash() {
    for (const { mesh, material } of this.painted.splice(0)) {
      mesh.material.dispose();
      mesh.material = material;
    }
    this.stage.dirty = true;
  }
}
