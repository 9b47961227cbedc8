// Who wears it: the service's body, or a character of the user's.
import { poseBones, readBody } from "../lib/src/body.js";
import { jointPlaces } from "../lib/src/kinematics.js";
import { skinMaterial } from "../lib/src/materials.js";
import { paintPerson } from "./person.js";

export const TONES = ["#d9bcaa", "#c39c88", "#a97e68", "#865d49", "#634437", "#42312b"];
const ANKLES = [7, 8];
const TOES = [10, 11];
const HEAD = 15;
const CROWN = 1.11; // of the way from toes to the joint of the head, to the crown

export class Figure {
  constructor(stage) {
    this.stage = stage;
    this.tone = TONES[1];
    this.shown = true;
    this.object = null;
    this.plain = stage.plain;
  }

  #material(person) {
    return paintPerson(skinMaterial(this.tone, { plain: this.plain }), person);
  }

  // The service's body from its message, for show().
  makeBody(buffer) {
    const { group, mesh, bones, rest } = readBody(buffer);
    mesh.geometry.computeBoundingBox();
    const person = { rest, crownM: mesh.geometry.boundingBox.max.y };
    mesh.material = this.#material(person);
    return { object: group, mesh, person, rest, pose: (pose, root) => poseBones(bones, pose, root) };
  }

  // Shows who poses itself from the next pose on: { object, rest, pose(pose, root) }, mesh where its skin is ours.
  show({ object, mesh = null, person = null, rest, pose }) {
    if (this.object) this.stage.scene.remove(this.object);
    this.object?.traverse((node) => node.geometry?.dispose());
    Object.assign(this, { object, mesh, person, rest, poseObject: pose, posed: false });
    if (mesh && this.plain) this.#repaint();
    this.stage.setHeight(CROWN * (rest[HEAD][1] - rest[TOES[0]][1]));
    if (object) {
      object.visible = false;
      this.stage.scene.add(object);
    }
  }

  setTone(tone) {
    this.tone = tone;
    this.#repaint();
  }

  setPlain() {
    this.plain = true;
    this.#repaint();
  }

  #repaint() {
    if (!this.mesh) return;
    this.mesh.material.dispose();
    this.mesh.material = this.#material(this.person);
    this.stage.dirty = true;
  }

  setShown(shown) {
    this.shown = shown;
    if (this.object) this.object.visible = shown && this.posed;
    this.stage.dirty = true;
  }

  pose(pose, root) {
    if (!this.rest) return;
    this.poseObject?.(pose, root);
    this.posed = true;
    if (this.object) this.object.visible = this.shown;
    const places = jointPlaces(pose, root, this.rest);
    this.stage.follow(root, { ankles: ANKLES.map((joint) => places[joint]), toes: TOES.map((joint) => places[joint]) });
  }
}
