// For engineers: what a frame takes, and options that people need no control for. Behind a key.
import * as THREE from "three";
import { BYTES, FLAG_PUSHED, FLAG_UNLIKE } from "../lib/src/wire.js";
import { element } from "./words.js";

const STATS_S = 0.5;
const WORDS = ["resolution"]; // the others are numbers

export class Readouts {
  // onOption(): another choice of how to drape; onMesh(): one for which other meshes are needed.
  constructor({ onOption, onMesh, onBody, onTriangles }) {
    this.since = performance.now();
    this.shown = 0;
    this.controls = [...document.querySelectorAll("[data-option], [data-advanced]")];
    for (const control of this.controls) control.addEventListener("change", control.id === "resolution" ? onMesh : onOption);
    element("jets").addEventListener("change", onMesh);
    element("body").addEventListener("change", () => onBody(element("body").checked));
    element("wire").addEventListener("change", () => onTriangles(element("wire").checked));
    element("numbers").addEventListener("click", () => this.toggle());
    element("numbers-close").addEventListener("click", () => this.toggle());
  }

  toggle() {
    const panel = element("readouts");
    panel.hidden = !panel.hidden;
    element("numbers").setAttribute("aria-expanded", !panel.hidden);
    if (panel.hidden) element("numbers").focus();
    else panel.focus();
  }

  // wanted: what the address names; passes: corrections that the model leaves to choose.
  offer(wanted, passes) {
    const counts = Array.from({ length: passes + 1 }, (_, i) => passes - i);
    const names = counts.map((count) => new Option(count === 0 ? "none" : String(count), String(count)));
    element("passes").replaceChildren(new Option("as the quality", ""), ...names);
    element("passes-row").hidden = passes === 0; // the model leaves no choice
    for (const name of ["passes", "folds", "resolution"]) {
      const values = [...element(name).options].map(({ value }) => value);
      if (values.includes(wanted.get(name))) element(name).value = wanted.get(name);
    }
    element("jets").checked = wanted.has("jets");
  }

  // Options of a drape (drape/wire/options.py) are the controls that name one, itself or one of advanced; an empty one is
  // left to the service.
  options() {
    const value = (control) => {
      if (control.type === "checkbox") return control.checked;
      return WORDS.includes(control.dataset.option) ? control.value : Number(control.value);
    };
    const chosen = this.controls.filter((control) => control.type === "checkbox" || control.value !== "");
    const named = (place) => Object.fromEntries(chosen.filter(({ dataset }) => dataset[place]).map((control) => [control.dataset[place], value(control)]));
    return { ...named("option"), advanced: named("advanced") };
  }

  take({ stats, header, opened }) {
    this.shown += 1;
    Object.assign(this, { stats: { ...stats }, header, opened });
  }

  tell(now) {
    if (now - this.since < 1000 * STATS_S) return;
    const { header, stats, opened } = this;
    element("fps").textContent = (this.shown / ((now - this.since) / 1000)).toFixed(0);
    if (header) {
      element("age").textContent = `${(1000 * stats.ageS).toFixed(0)} ms`;
      element("residence").textContent = `${(header.residence_us / 1000).toFixed(0)} ms`;
      element("dropped").textContent = String(header.dropped);
      element("quality").textContent = opened.tier + (header.flags & FLAG_UNLIKE ? ", more folds: a pose unlike training" : "");
      element("pushed").textContent = header.flags & FLAG_PUSHED ? `${(100 * header.pushed_share).toFixed(1)} %` : "off";
      if (stats.bytes > BYTES.SAME) element("bytes").textContent = `${(stats.bytes / 1000).toFixed(1)} kB`;
      element("left-row").hidden = header.left_m === undefined;
      element("left").textContent = `${(1000 * (header.left_m ?? 0)).toFixed(1)} mm`;
    }
    this.shown = 0;
    this.since = now;
  }
}

// The triangles of what is worn, drawn over it.
export class Triangles {
  constructor() {
    this.shown = false;
    this.material = new THREE.MeshBasicMaterial({ color: 0x14202c, wireframe: true, transparent: true, opacity: 0.28 });
    this.material.visible = false;
  }

  show(shown) {
    this.material.visible = shown;
  }

  draw(worn) {
    for (const mesh of worn.meshes) {
      if (mesh.children.length) continue;
      const lines = new THREE.Mesh(mesh.geometry, this.material);
      mesh.add(lines);
    }
  }
}
