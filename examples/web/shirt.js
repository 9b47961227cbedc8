// A T-shirt that moves, for any bundler: npm install @drape/client three. The address may name another service=.
import * as THREE from "three";
import { connect } from "@drape/client";

const renderer = new THREE.WebGLRenderer({ antialias: true });
renderer.setSize(innerWidth, innerHeight);
document.body.append(renderer.domElement);
const scene = new THREE.Scene().add(new THREE.HemisphereLight(0xffffff, 0x8d8478, 3));
scene.background = new THREE.Color("#e9e5de");
const camera = new THREE.PerspectiveCamera(35, innerWidth / innerHeight).translateY(1).translateZ(3.5);

async function wear() {
  const drape = await connect(new URLSearchParams(location.search).get("service") ?? "http://127.0.0.1:8000");
  const shirt = await drape.wear("tshirt", { tier: "fast", body: true, folds_by: "client", colours: ["#2f6fb0"] });
  shirt.addEventListener("frame", () => (document.body.dataset.frames = shirt.stats.frames));
  scene.add(shirt);
  await shirt.play("stretch");
  renderer.setAnimationLoop(() => renderer.render(scene, camera));
}

wear().catch((error) => (document.body.textContent = error.message));
