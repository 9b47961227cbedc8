// The stage: canvas, camera and light, and how plainly a slow machine draws.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { Ground, keyLight, studioEnvironment } from "./light.js";

const ROOM = 1.09; // of a person's height: what the picture shows of it at first
const WIDTH_M = 1.2; // and across: arms that are out a little
const USUAL_M = 1.83;
const FURTHEST_M = 7.5;
const EYE = new THREE.Vector3(0.34, 0.05, 1).normalize(); // from the middle of the body
const MIDDLE = 0.507; // of a person's height, in the middle of the picture
const TURN_RAD = 0.12; // of a key
const NEARER = 0.88;
const SLOW_RATE = 20; // drawings per second below which the picture becomes plainer
const SLOW_WATCH_S = 1;

// Without a graphics card the browser draws on the processor.
function drawsInSoftware(renderer) {
  const gl = renderer.getContext();
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  return names !== null && /swiftshader|llvmpipe|software/i.test(gl.getParameter(names.UNMASKED_RENDERER_WEBGL));
}

export class Stage {
  // With keepQuality the picture stays as it is on a slow machine, for pictures.
  constructor(canvas, { keepQuality = false } = {}) {
    this.keepQuality = keepQuality;
    this.onPlain = () => {}; // from now on it is drawn plainly
    const wanted = { antialias: true, alpha: true };
    const context = canvas.getContext("webgl2", wanted);
    if (!context) throw new Error("This page needs WebGL 2, and the browser gave none.");
    this.renderer = new THREE.WebGLRenderer({ canvas, context, ...wanted });
    this.renderer.toneMapping = THREE.NeutralToneMapping;
    this.renderer.toneMappingExposure = 1.0;
    this.renderer.shadowMap.enabled = true;
    this.renderer.debug.checkShaderErrors = false; // to ask is to wait
    this.plainness = 0;
    this.pixelShare = 1;
    this.dirty = true;
    this.ticks = { count: 0, since: performance.now() };

    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(26, 1, 0.05, 40);
    this.place = new THREE.Vector3(0, MIDDLE * USUAL_M, 0);
    this.heightM = USUAL_M;
    this.controls = new OrbitControls(this.camera, canvas);
    Object.assign(this.controls, { enableDamping: true, dampingFactor: 0.12, minDistance: 0.45, maxDistance: FURTHEST_M, maxPolarAngle: 0.52 * Math.PI });
    this.controls.addEventListener("start", () => (this.moved = true));
    this.moved = false; // whether somebody has looked from elsewhere

    this.studio = new THREE.Group();
    this.sun = keyLight();
    this.fill = new THREE.HemisphereLight(0xffffff, 0xb5a898, 1.7); // stands in for the environment
    this.fill.visible = false;
    this.studio.add(this.sun, this.sun.target, this.fill);
    this.ground = new Ground();
    this.scene.add(this.studio, this.ground.group);

    const dark = matchMedia("(prefers-color-scheme: dark)");
    const lit = () => {
      this.ground.setDark(dark.matches);
      this.dirty = true;
    };
    dark.addEventListener("change", lit);
    lit();
    this.insets = { left: 0, right: 0, top: 0, bottom: 0 };
    new ResizeObserver(() => this.resize()).observe(canvas);
    if (!keepQuality && drawsInSoftware(this.renderer)) this.simplify();
    else this.#lightByImage();
  }

  get plain() {
    return this.plainness > 0;
  }

  #lightByImage() {
    this.scene.environment = studioEnvironment(this.renderer);
    this.scene.environmentIntensity = 0.72;
  }

  // Pixels of each side that controls cover: the person stands in the middle of the rest.
  setInsets(insets) {
    Object.assign(this.insets, insets);
    this.resize();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.renderer.domElement;
    if (!width || !height) return;
    this.renderer.setPixelRatio(this.pixelShare * Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    const { left, right, top, bottom } = this.insets;
    this.camera.setViewOffset(width, height, (right - left) / 2, (bottom - top) / 2, width, height);
    this.camera.updateProjectionMatrix();
    if (!this.moved) this.fit();
    this.dirty = true;
  }

  // How tall the person is [m].
  setHeight(heightM) {
    this.heightM = heightM;
    this.place.y = MIDDLE * heightM;
    if (!this.moved) this.fit();
  }

  // The whole person, in what controls leave free.
  fit() {
    const { clientWidth: width, clientHeight: height } = this.renderer.domElement;
    const { left, right, top, bottom } = this.insets;
    const perMetre = Math.min((height - top - bottom) / (ROOM * this.heightM), (width - left - right) / WIDTH_M); // pixels
    const distance = height / Math.max(perMetre, 1) / (2 * Math.tan((this.camera.fov * Math.PI) / 360));
    this.controls.maxDistance = Math.max(FURTHEST_M, 1.2 * distance);
    this.controls.target.copy(this.place);
    this.camera.position.copy(EYE).multiplyScalar(distance).add(this.place);
    this.moved = false;
    this.dirty = true;
  }

  // By keys: turns about the person [rad], or comes nearer (above 0) or goes further away.
  turn(sideways, upwards) {
    const way = this.camera.position.clone().sub(this.controls.target);
    const ball = new THREE.Spherical().setFromVector3(way);
    ball.theta -= TURN_RAD * sideways;
    ball.phi = Math.min(this.controls.maxPolarAngle, Math.max(0.1, ball.phi - TURN_RAD * upwards));
    this.camera.position.copy(this.controls.target).add(way.setFromSpherical(ball));
    this.moved = this.dirty = true;
  }

  come(nearer) {
    const way = this.camera.position.clone().sub(this.controls.target);
    const { minDistance, maxDistance } = this.controls;
    way.setLength(Math.min(maxDistance, Math.max(minDistance, way.length() * NEARER ** nearer)));
    this.camera.position.copy(this.controls.target).add(way);
    this.moved = this.dirty = true;
  }

  // Camera, lights and ground go with the body; its height is left alone.
  follow(root, { ankles, toes }) {
    const step = new THREE.Vector3(root[0] - this.place.x, 0, root[2] - this.place.z);
    this.place.add(step);
    this.camera.position.add(step);
    this.controls.target.add(step);
    this.studio.position.set(root[0], 0, root[2]);
    this.ground.follow(root, ankles, toes);
    this.dirty = true;
  }

  // One step plainer: without shadows, weave and image light, then with fewer pixels.
  simplify() {
    if (this.keepQuality || this.plainness === 2) return;
    this.plainness += 1;
    if (this.plainness === 1) {
      this.sun.castShadow = false;
      this.ground.cast.visible = false;
      this.fill.visible = true;
      this.scene.environment = null;
      this.onPlain();
    } else {
      this.pixelShare = 0.6;
      this.resize();
    }
    this.dirty = true;
  }

  // Promises that an object can be drawn without a wait for its shaders.
  async ready(object) {
    await Promise.all([object, this.ground.group].map((one) => this.renderer.compileAsync(one, this.camera, this.scene)));
  }

  // Draws where something has changed.
  render() {
    if (this.controls.update()) this.dirty = true;
    if (!this.dirty) return;
    this.dirty = false;
    this.renderer.render(this.scene, this.camera);
  }

  // A machine without a graphics card draws slowly: it gets a plainer picture, not fewer frames. To be called as often as the
  // browser lets the page draw.
  watch(now) {
    this.ticks.count += 1;
    if (now - this.ticks.since < SLOW_WATCH_S * 1000) return;
    if (this.ticks.count < SLOW_RATE * SLOW_WATCH_S && document.visibilityState === "visible") this.simplify();
    this.ticks = { count: 0, since: now };
  }
}
