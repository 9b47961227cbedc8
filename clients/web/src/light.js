// The light of the studio: an environment of soft boxes drawn once, a key light that casts shade, shadows of contact.
import * as THREE from "three";

const SOLE_M = 0.11; // of an ankle above the floor when its foot stands
const BLOB_PX = 128;

// Panels of light around an origin: [width, height, distance], direction, brightness, colour.
const BOXES = [
  [[4, 3, 5], [0.8, 0.75, 0.6], 9, 0xfff9f0], // key, from the right front
  [[3, 4, 5], [-1, 0.25, 0.45], 2.6, 0xe6eeff], // fill
  [[1.2, 4, 4], [-0.7, 0.35, -1], 7, 0xeaf1ff], // rim
  [[1.2, 4, 4], [0.9, 0.3, -1], 5, 0xfff6ea],
  [[5, 5, 4], [0, 1, 0], 3.2, 0xffffff], // ceiling
];

export function studioEnvironment(renderer) {
  const room = new THREE.Scene();
  room.background = new THREE.Color(0x6e6e6e);
  for (const [[width, height, distance], direction, brightness, colour] of BOXES) {
    const material = new THREE.MeshBasicMaterial({ color: new THREE.Color(colour).multiplyScalar(brightness), side: THREE.DoubleSide });
    const panel = new THREE.Mesh(new THREE.PlaneGeometry(width, height), material);
    panel.position.set(...direction).normalize().multiplyScalar(distance);
    panel.lookAt(0, 0, 0);
    room.add(panel);
  }
  const floor = new THREE.Mesh(new THREE.CircleGeometry(6, 32).rotateX(-0.5 * Math.PI), new THREE.MeshBasicMaterial({ color: 0xa5a19a }));
  floor.position.y = -1.2;
  room.add(floor);
  const generator = new THREE.PMREMGenerator(renderer);
  const { texture } = generator.fromScene(room, 0.03);
  generator.dispose();
  return texture;
}

export function keyLight() {
  const sun = new THREE.DirectionalLight(0xfff8ee, 1.5);
  sun.position.set(2.4, 3.4, 2.2);
  sun.castShadow = true;
  sun.shadow.mapSize.set(2048, 2048);
  sun.shadow.radius = 4;
  sun.shadow.bias = -0.0003;
  sun.shadow.normalBias = 0.012;
  Object.assign(sun.shadow.camera, { left: -1.3, right: 1.3, top: 1.5, bottom: -1.5, near: 0.5, far: 8 });
  return sun;
}

function blobTexture(stops) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = BLOB_PX;
  const context = canvas.getContext("2d");
  const half = BLOB_PX / 2;
  const gradient = context.createRadialGradient(half, half, 0, half, half, half);
  for (const [at, colour] of stops) gradient.addColorStop(at, colour);
  context.fillStyle = gradient;
  context.fillRect(0, 0, BLOB_PX, BLOB_PX);
  return new THREE.CanvasTexture(canvas);
}

function flat(texture, opacity, order) {
  const material = new THREE.MeshBasicMaterial({ map: texture, transparent: true, opacity, depthWrite: false, toneMapped: false });
  const mesh = new THREE.Mesh(new THREE.PlaneGeometry(1, 1).rotateX(-0.5 * Math.PI), material);
  mesh.renderOrder = order;
  mesh.position.y = 0.002 * order;
  return mesh;
}

// What lies under the person: a pool of light, the shade of the whole, and that of each foot, darker the nearer it is.
export class Ground {
  constructor() {
    const dark = blobTexture([[0, "rgba(18,16,14,1)"], [0.35, "rgba(18,16,14,0.55)"], [0.7, "rgba(18,16,14,0.14)"], [1, "rgba(18,16,14,0)"]]);
    this.group = new THREE.Group();
    this.pool = flat(blobTexture([[0, "rgba(255,255,255,1)"], [0.55, "rgba(255,255,255,0.55)"], [1, "rgba(255,255,255,0)"]]), 0.5, 1);
    this.pool.scale.setScalar(4.6);
    this.whole = flat(dark, 0.3, 2);
    this.whole.scale.set(1.1, 1, 1);
    this.feet = [flat(dark, 0.6, 3), flat(dark, 0.6, 3)];
    this.group.add(this.pool, this.whole, ...this.feet);
    this.cast = new THREE.Mesh(new THREE.CircleGeometry(3, 48).rotateX(-0.5 * Math.PI), new THREE.ShadowMaterial({ opacity: 0.2 }));
    this.cast.receiveShadow = true;
    this.group.add(this.cast);
  }

  setDark(dark) {
    this.pool.material.opacity = dark ? 0.07 : 0.55;
    this.whole.material.opacity = dark ? 0.5 : 0.26;
    this.cast.material.opacity = dark ? 0.4 : 0.2;
    this.footShade = dark ? 0.85 : 0.62;
  }

  // ankles and toes [m] in the world, the left ones first: arrays of x, y, z; root: the body's.
  follow([x, , z], ankles, toes) {
    this.group.position.set(x, 0, z);
    ankles.forEach((ankle, i) => {
      const [foot, toe] = [this.feet[i], toes[i]];
      const way = Math.atan2(toe[0] - ankle[0], toe[2] - ankle[2]);
      foot.position.set((ankle[0] + 1.1 * toe[0]) / 2.1 - x, 0.006, (ankle[2] + 1.1 * toe[2]) / 2.1 - z);
      foot.rotation.y = way;
      const lifted = Math.max(0, Math.min(ankle[1] - SOLE_M, toe[1] - 0.03));
      const spread = 1 + 4 * lifted;
      foot.scale.set(0.2 * spread, 1, 0.37 * spread);
      foot.material.opacity = this.footShade / (1 + (lifted / 0.05) ** 2);
    });
  }
}
