// What is worn, as an object of three.js: its meshes move by themselves as frames come.
import { BufferAttribute, BufferGeometry, Color, DoubleSide, DynamicDrawUsage, Group, Mesh, MeshPhysicalMaterial, Sphere, Vector3 } from "three";
import { poseBones } from "./body.js";

const COLOURS = ["#66656b", "#969c8c", "#8a6a5a", "#6f7f8f"]; // charcoal, sage, clay, steel
const REACH_M = 2.5; // of cloth from the root, arms and hems included: a sphere that needs no counting

function clothMaterial(colour) {
  const color = new Color(colour);
  // Fibres scatter light at grazing angles in a paler tone of the cloth's own colour.
  const sheenColor = color.clone().lerp(new Color(0xffffff), 0.4);
  const rough = { roughness: 1, specularIntensity: 0.15, sheen: 0.7, sheenRoughness: 0.45 };
  return new MeshPhysicalMaterial({ color, sheenColor, side: DoubleSide, shadowSide: DoubleSide, ...rough });
}

function clothMesh({ id, vertexCount, copies, index, uv }, colour) {
  const geometry = new BufferGeometry();
  for (const name of ["position", "normal"]) {
    const attribute = new BufferAttribute(new Float32Array(3 * (vertexCount + copies.length)), 3);
    geometry.setAttribute(name, attribute.setUsage(DynamicDrawUsage));
  }
  if (uv) geometry.setAttribute("uv", new BufferAttribute(uv, 2));
  geometry.setIndex(new BufferAttribute(index, 1));
  const mesh = new Mesh(geometry, clothMaterial(colour));
  mesh.name = id;
  mesh.visible = false; // until its first frame
  mesh.castShadow = mesh.receiveShadow = true;
  geometry.boundingSphere = new Sphere(new Vector3(), REACH_M);
  return mesh;
}

// Moving the group moves all; within it the axes are the world's of the poses, y up. Events: "frame", "state".
export class Worn extends Group {
  // figure: the service's body (readBody), which appears with the first frame, or null.
  constructor(wearing, { colours = COLOURS, figure = null } = {}) {
    super();
    this.wearing = wearing;
    this.meshes = wearing.layers.map((layer, i) => clothMesh(layer, colours[i % colours.length]));
    this.add(...this.meshes);
    this.figure = figure;
    this.body = figure?.group ?? null;
    if (figure) {
      this.body.visible = false;
      this.add(this.body);
    }
    wearing.onFrame = () => this.#show();
    wearing.onState = (state, refusal) => this.dispatchEvent({ type: "state", state, error: refusal });
  }

  // The outermost garment.
  get mesh() {
    return this.meshes.at(-1);
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
    return this.wearing.follow(source);
  }

  play(motion, choice) {
    return this.wearing.play(motion, choice);
  }

  stop() {
    this.wearing.stop();
  }

  fabric(name) {
    return this.wearing.fabric(name);
  }

  set(options) {
    return this.wearing.set(options);
  }

  // Ends its stream and frees what it holds.
  dispose() {
    this.wearing.close();
    this.removeFromParent();
    for (const mesh of this.figure ? [...this.meshes, this.figure.mesh] : this.meshes) {
      mesh.geometry.dispose();
      mesh.material.dispose();
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
    if (this.figure && wearing.bodyPose) {
      poseBones(this.figure.bones, wearing.bodyPose, wearing.root);
      this.body.visible = true;
    }
    this.dispatchEvent({ type: "frame" });
  }
}
