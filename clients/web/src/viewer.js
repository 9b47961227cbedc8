// The scene: a studio, the skinned body, the garments whose vertices or jets arrive frame by frame.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";
import { poseBones, readBody } from "../lib/src/body.js";
import { Decoder } from "../lib/src/decode.js";

const BACKGROUND = 0xe9e5de;
const GRID_CELL_M = 0.5;
const NARROW_PX = 640; // as in style.css
const EYE = new THREE.Vector3(1.4, 0.35, 3.9); // from the body's root [m]

// Without a graphics card the browser draws on the processor.
function drawsInSoftware(renderer) {
  const gl = renderer.getContext();
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  return names !== null && /swiftshader|llvmpipe|software/i.test(gl.getParameter(names.UNMASKED_RENDERER_WEBGL));
}

// Fibres scatter light at grazing angles in a paler tone of the cloth's own colour.
function dyed(cloth, colour) {
  cloth.color.set(colour);
  cloth.sheenColor?.set(colour).lerp(new THREE.Color(0xffffff), 0.4);
  return cloth;
}

export class Viewer {
  // With keepQuality the picture stays as it is on a slow machine, for pictures.
  constructor(canvas, { keepQuality = false } = {}) {
    this.keepQuality = keepQuality;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.plainness = 0;
    this.pixelShare = 1;
    this.renderer.shadowMap.enabled = true;
    this.renderer.toneMapping = THREE.NeutralToneMapping;
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(BACKGROUND);
    this.scene.fog = new THREE.Fog(BACKGROUND, 7, 16);
    const plain = !keepQuality && drawsInSoftware(this.renderer);
    if (!plain) {
      const generator = new THREE.PMREMGenerator(this.renderer);
      this.scene.environment = generator.fromScene(new RoomEnvironment(), 0.04).texture;
      this.scene.environmentIntensity = 0.3;
      generator.dispose();
    }

    this.camera = new THREE.PerspectiveCamera(32, 1, 0.05, 60);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = true;
    this.controls.minDistance = 0.6;
    this.controls.maxDistance = 9;
    this.controls.maxPolarAngle = 0.53 * Math.PI;
    this.place = new THREE.Vector3(0, 0.92, 0);
    this.controls.target.copy(this.place);
    this.camera.position.copy(this.place).add(EYE);

    this.#makeStudio();
    this.#makeGarments();
    this.#makeBodyMaterial();
    new ResizeObserver(() => this.#resize()).observe(canvas);
    this.#resize();
    if (plain) this.simplify();
  }

  #makeStudio() {
    this.studio = new THREE.Group();
    const sun = new THREE.DirectionalLight(0xfff4e6, 2.4);
    sun.position.set(3.0, 3.2, 1.5); // from the side, so that folds cast shade
    sun.castShadow = true;
    sun.shadow.mapSize.set(1024, 1024);
    sun.shadow.radius = 5;
    sun.shadow.bias = -0.0004;
    sun.shadow.normalBias = 0.012;
    Object.assign(sun.shadow.camera, { left: -1.4, right: 1.4, top: 1.6, bottom: -1.6, near: 0.5, far: 9 });
    const rim = new THREE.DirectionalLight(0xdfe9ff, 0.7);
    rim.position.set(-2.5, 2.2, -2.5);
    this.sun = sun;
    this.fill = new THREE.HemisphereLight(0xffffff, 0xc4b8a8, 1.9); // stands in for the environment
    this.fill.visible = false;
    this.studio.add(sun, sun.target, rim, rim.target, this.fill);
    this.scene.add(this.studio);

    const material = new THREE.MeshStandardMaterial({ color: 0xded9d0, roughness: 0.95 });
    this.ground = new THREE.Mesh(new THREE.CircleGeometry(24, 64).rotateX(-0.5 * Math.PI), material);
    this.ground.receiveShadow = true;
    this.grid = new THREE.GridHelper(24, 24 / GRID_CELL_M, 0xc4bdb1, 0xcfc9be);
    this.grid.position.y = 0.001;
    this.scene.add(this.ground, this.grid);
  }

  #makeGarments() {
    this.layers = []; // innermost first
    this.garments = new THREE.Group();
    this.garments.visible = false;
    this.lines = new THREE.MeshBasicMaterial({ color: 0x14202c, wireframe: true, transparent: true, opacity: 0.28 });
    this.lines.visible = false;
    this.scene.add(this.garments);
  }

  #cloth(color) {
    if (this.plainness > 0) return new THREE.MeshLambertMaterial({ color, side: THREE.DoubleSide });
    const cloth = new THREE.MeshPhysicalMaterial({
      side: THREE.DoubleSide, shadowSide: THREE.DoubleSide,
      roughness: 1, specularIntensity: 0.15, sheen: 0.7, sheenRoughness: 0.45,
    });
    return dyed(cloth, color);
  }

  #makeBodyMaterial() {
    this.skin = new THREE.MeshStandardMaterial({ color: 0xcdb3a0, roughness: 0.72 });
    this.showBody = true;
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.renderer.domElement;
    if (!width || !height) return;
    this.renderer.setPixelRatio(this.pixelShare * Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // The panel covers the left, or the top of a narrow screen: look past it.
    const narrow = width <= NARROW_PX;
    const [left, top] = narrow ? [0, 0.42 * height] : [296, 0];
    this.camera.zoom = narrow ? 0.6 : 1;
    this.camera.setViewOffset(width, height, -left / 2, -top / 2, width, height);
    this.camera.updateProjectionMatrix();
  }

  setColour(layer, colour) {
    if (this.layers[layer]) dyed(this.layers[layer].cloth.material, colour);
  }

  // One step plainer: without shadows and sheen, then with fewer pixels.
  simplify() {
    if (this.keepQuality || this.plainness === 2) return;
    this.plainness += 1;
    if (this.plainness === 1) {
      this.sun.castShadow = false;
      for (const { cloth } of this.layers) cloth.material = this.#cloth(cloth.material.color);
      this.skin = new THREE.MeshLambertMaterial({ color: this.skin.color });
      if (this.bodyMesh) this.bodyMesh.material = this.skin;
      this.ground.material = new THREE.MeshLambertMaterial({ color: this.ground.material.color });
      this.fill.visible = true;
      this.scene.environment = null;
    } else {
      this.pixelShare = 0.6;
      this.#resize();
    }
  }

  setTriangles(shown) {
    this.lines.visible = shown;
  }

  setBodyShown(shown) {
    this.showBody = shown;
    if (this.body) this.body.visible = shown && this.posed;
  }

  // Takes the body file; it appears with the next frame.
  async setBody(buffer) {
    const { group, mesh, bones } = await readBody(buffer, this.skin);
    if (this.body) this.scene.remove(this.body);
    this.body = group;
    this.body.visible = false;
    this.posed = false;
    this.bodyMesh = mesh;
    this.bones = bones;
    this.scene.add(group);
  }

  // worn: of each layer, innermost first, its topology, the bytes of its layout of jets or null, its colour. Shown with
  // a frame.
  setGarments(worn) {
    for (const { cloth } of this.layers) {
      cloth.geometry.dispose();
      cloth.material.dispose();
    }
    this.garments.clear();
    this.garments.visible = false;
    this.decoder = new Decoder(worn);
    this.layers = worn.map(({ vertexCount, copies, index, colour }) => {
      const geometry = new THREE.BufferGeometry();
      for (const name of ["position", "normal"]) {
        const attribute = new THREE.BufferAttribute(new Float32Array(3 * (vertexCount + copies.length)), 3);
        geometry.setAttribute(name, attribute.setUsage(THREE.DynamicDrawUsage));
      }
      geometry.setIndex(new THREE.BufferAttribute(index, 1));
      const cloth = new THREE.Mesh(geometry, this.#cloth(colour));
      cloth.castShadow = cloth.receiveShadow = true;
      const triangles = new THREE.Mesh(geometry, this.lines);
      cloth.frustumCulled = triangles.frustumCulled = false;
      cloth.add(triangles);
      this.garments.add(cloth);
      return { cloth };
    });
    this.targets = this.layers.map(({ cloth: { geometry } }) => {
      const { position, normal } = geometry.attributes;
      return { positions: position.array, normals: normal.array };
    });
  }

  // frame: what the stream hands over, with the pose that it answers.
  show(frame) {
    const { header, pose, data } = frame;
    if (!this.layers.length || !this.decoder.decode(data, this.targets)) return false;
    for (const { cloth } of this.layers) {
      const { position, normal } = cloth.geometry.attributes;
      position.needsUpdate = normal.needsUpdate = true;
    }
    this.garments.position.fromArray(header.root);
    this.garments.visible = true;
    if (this.bones) this.#poseBody(pose, header.root);
    this.#follow(header.root);
    return true;
  }

  #poseBody(pose, root) {
    poseBones(this.bones, pose, root);
    this.posed = true;
    this.body.visible = this.showBody;
  }

  // Camera, lights and floor go with the body; its height is left alone.
  #follow([x, , z]) {
    const step = new THREE.Vector3(x - this.place.x, 0, z - this.place.z);
    this.place.add(step);
    this.camera.position.add(step);
    this.controls.target.add(step);
    this.studio.position.set(x, 0, z);
    this.ground.position.set(x, 0, z);
    this.grid.position.set(GRID_CELL_M * Math.round(x / GRID_CELL_M), 0.001, GRID_CELL_M * Math.round(z / GRID_CELL_M));
  }

  render() {
    this.controls.update();
    this.renderer.render(this.scene, this.camera);
  }
}
