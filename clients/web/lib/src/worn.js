// What is worn, as an object of three.js: its meshes move by themselves as frames come.
import { BufferAttribute, BufferGeometry, DynamicDrawUsage, Group, Mesh, Sphere, Vector3 } from "three";
import { poseBones } from "./body.js";
import { FURTHEST_M, borderDistances } from "./borders.js";
import { coverSkin } from "./covered.js";
import { DrapeError } from "./errors.js";
import { clothMaterial, dye } from "./materials.js";
import { fetchPictures, groupByMaterial, withPictures } from "./pictures.js";

const COLOURS = ["#66656b", "#969c8c", "#8a6a5a", "#6f7f8f"]; // charcoal, sage, clay, steel
const OVER_M = 0.008; // garments that lie on each other cross by less, nearly everywhere
const REACH_M = 2.5; // of cloth from the root, arms and hems included: a sphere that needs no counting

function clothMesh(layer) {
  const { id, vertexCount, copies, index, uv } = layer;
  const total = vertexCount + copies.length;
  const geometry = new BufferGeometry();
  for (const name of ["position", "normal"]) {
    const attribute = new BufferAttribute(new Float32Array(3 * total), 3);
    geometry.setAttribute(name, attribute.setUsage(DynamicDrawUsage));
  }
  if (uv) {
    geometry.setAttribute("uv", new BufferAttribute(uv, 2));
    geometry.setAttribute("border", new BufferAttribute(new Float32Array(2 * total).fill(FURTHEST_M), 2)); // until it moves
  }
  geometry.setIndex(new BufferAttribute(index, 1));
  const mesh = new Mesh(geometry);
  mesh.name = id;
  mesh.visible = false; // until its first frame
  mesh.castShadow = mesh.receiveShadow = true;
  geometry.boundingSphere = new Sphere(new Vector3(), REACH_M);
  return mesh;
}

function dispose(materials) {
  for (const material of [materials ?? []].flat()) {
    for (const name of ["map", "normalMap", "roughnessMap"]) if (material.userData.own) material[name]?.dispose();
    material.dispose();
  }
}

// Gives the mesh of a layer its lines along seams and hems.
function drawBorders({ geometry: { attributes } }, layer) {
  if (!attributes.border) return;
  attributes.border.array.set(borderDistances(layer));
  attributes.border.needsUpdate = true;
}

// Moving the group moves all; within it the axes are the world's of the poses, y up. Events: "frame", "state", "folds", "cover".
export class Worn extends Group {
  // figure: the service's body (readBody), which appears with the first frame, or null. looks: a function that promises
  // the look of each layer (materials.js) for the option fabric. plain: cheap to draw. covers: whether the skin of a rig
  // that is followed lies deeper below the garments by itself.
  constructor(wearing, { colours = COLOURS, figure = null, looks, plain = false, covers = true }) {
    super();
    this.covers = covers;
    this.covering = null; // { skin, covered, end }: covered when it is known, end when it is drawn
    this.wearing = wearing;
    this.findLooks = looks;
    this.colours = colours;
    this.plain = plain;
    this.looks = [];
    this.bordered = false;
    this.dyed = []; // the materials that are ours, a list of them where a garment has pictures
    this.pictures = null; // a promise of each layer's
    this.meshes = wearing.layers.map(clothMesh);
    this.add(...this.meshes);
    this.figure = figure;
    this.body = figure?.group ?? null;
    if (figure) {
      this.body.visible = false;
      this.add(this.body);
    }
    wearing.onFrame = () => this.#show();
    wearing.onFolds = () => this.dispatchEvent({ type: "folds", by: "server", tookS: wearing.pace.typicalS, allowedS: wearing.pace.allowedS });
    wearing.onState = (state, refusal) => this.dispatchEvent({ type: "state", state, error: refusal });
  }

  // Gives the garments the materials of their fabrics; a material that is not ours stays.
  async dress(fabric = this.wearing.options.fabric) {
    const { layers, drape, options } = this.wearing;
    this.pictures ??= Promise.all(layers.map(({ id, uv }) => (uv ? fetchPictures(drape.rest, id, options.resolution).catch(() => null) : null)));
    [this.looks, this.pictured] = await Promise.all([this.findLooks(fabric), this.pictures]);
    this.#makeMaterials();
    return this;
  }

  // plain: without weave, sheen and the like, for machines that draw slowly.
  setPlain(plain) {
    if (this.plain === plain) return;
    this.plain = plain;
    this.#makeMaterials();
  }

  // Dyes one garment, the innermost is 0.
  colour(layer, colour) {
    this.colours = this.meshes.map((_, i) => (i === layer ? colour : this.colours[i % this.colours.length]));
    for (const material of [this.dyed[layer] ?? []].flat()) if (!material.userData.own) dye(material, colour);
  }

  #makeMaterials() {
    this.meshes.forEach((mesh, i) => {
      const own = this.dyed[i];
      const { uvMetres } = this.wearing.layers[i];
      const how = { colour: this.colours[i % this.colours.length], uvMetres, bordered: uvMetres !== null, plain: this.plain, nearerM: OVER_M * i };
      const pictured = this.pictured?.[i];
      // A picture has its own seams and shades.
      const cloth = (look) => clothMaterial(this.looks[i], { ...how, bordered: how.bordered && !look });
      const made = (look) => withPictures(cloth(look), look, pictured?.bitmaps);
      if (pictured) groupByMaterial(mesh.geometry, pictured);
      this.dyed[i] = pictured ? pictured.materials.map(made) : made(null);
      if (own && mesh.material !== own) return;
      mesh.material = this.dyed[i];
      dispose(own);
    });
  }

  // The outermost garment.
  get mesh() {
    return this.meshes.at(-1);
  }

  // The pose that the shown frame answers, 72 numbers, and where its root is [m]; null before the first.
  get bodyPose() {
    return this.wearing.bodyPose;
  }

  get root() {
    return this.wearing.root;
  }

  get stats() {
    return this.wearing.stats;
  }

  get state() {
    return this.wearing.state;
  }

  get foldsBy() {
    return this.wearing.foldsBy;
  }

  pose(poses, trans) {
    return this.wearing.pose(poses, trans);
  }

  rigPose(quaternions, place) {
    return this.wearing.rigPose(quaternions, place);
  }

  follow(source) {
    if (this.covers && source?.object && this.wearing.options.avatar && this.covering?.skin !== source.object) {
      this.cover(source.object).catch((error) => this.dispatchEvent({ type: "cover", error }));
    }
    return this.wearing.follow(source);
  }

  // From its first frame on, draws the skin of the avatar that lies below the garments a little deeper than it is, so that
  // it does not stand through them, without own clothes that they replace. skin: the character, an Object3D; null: as it was.
  async cover(skin) {
    this.covering?.end?.();
    const now = skin && { skin };
    this.covering = now;
    if (!now) return;
    const { drape, layers, options } = this.wearing;
    if (!options.avatar) {
      const words = { name: "cover", expected: "a garment that is worn by an avatar", got: "one on the service's body", kind: "InputError" };
      throw new DrapeError({ ...words, cure: "wear() takes avatar." });
    }
    const ids = layers.map(({ id }) => id);
    const asked = [options.avatar, ids, ids.map((id) => this.wearing.sizeOf(id))];
    const covered = await drape.rest.covered(...asked);
    now.bare = covered.bare ? await drape.rest.bare(...asked) : null;
    now.covered = covered;
    if (this.covering === now && this.mesh.visible) this.#cover();
  }

  #cover() {
    const { covering } = this;
    if (!covering?.covered || covering.end) return;
    const uncover = coverSkin(covering.skin, covering.covered);
    const skin = covering.bare && import("./bare.js").then(({ bareSkin }) => bareSkin(covering.skin, covering.bare)).catch(() => () => {});
    covering.end = () => {
      uncover();
      skin?.then((off) => off());
    };
  }

  play(motion, choice) {
    return this.wearing.play(motion, choice);
  }

  stop() {
    this.wearing.stop();
  }

  fabric(name) {
    return this.set({ fabric: name });
  }

  async set(options) {
    await this.wearing.set(options);
    if ("fabric" in options) await this.dress();
  }

  // Ends its stream and frees what it holds.
  dispose() {
    this.covering?.end?.();
    this.covering = null;
    this.wearing.close();
    this.removeFromParent();
    for (const mesh of this.figure ? [...this.meshes, this.figure.mesh] : this.meshes) {
      mesh.geometry.dispose();
      dispose(mesh.material);
    }
  }

  #show() {
    const { wearing } = this;
    this.meshes.forEach(({ geometry }, i) => {
      const { position, normal } = geometry.attributes;
      position.array.set(wearing.positions[i]);
      normal.array.set(wearing.normals[i]);
      position.needsUpdate = normal.needsUpdate = true;
    });
    for (const mesh of this.meshes) {
      mesh.position.fromArray(wearing.root);
      mesh.visible = true;
    }
    this.#cover();
    if (this.figure && wearing.bodyPose) {
      poseBones(this.figure.bones, wearing.bodyPose, wearing.root);
      this.body.visible = true;
    }
    this.dispatchEvent({ type: "frame" });
    if (this.bordered || wearing.stats.frames < 2) return;
    this.bordered = true; // cloth that moves comes first
    this.meshes.forEach((mesh, i) => setTimeout(() => drawBorders(mesh, wearing.layers[i])));
  }
}
