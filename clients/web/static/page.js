// A garment from the folder that this page lies in, draped by the browser alone. ?quality=high draws as on a graphics card.
import { Box3 } from "three";
import { jointPlaces } from "../lib/src/kinematics.js";
import { openFolder } from "../lib/src/local.js";
import { skinMaterial } from "../lib/src/materials.js";
import { paintPerson } from "../src/person.js";
import { Stage } from "../src/stage.js";

const COLOUR = "#8fa3b5";
const TONE = "#c39c88";
const GAP_PX = 32; // around the words below
const [ANKLES, TOES] = [[7, 8], [10, 11]];
const wanted = new URLSearchParams(location.search);
const status = document.querySelector("[role=status]");

async function begin() {
  const stage = new Stage(document.querySelector("canvas"), { keepQuality: wanted.get("quality") === "high" });
  stage.setInsets({ bottom: document.querySelector("main").offsetHeight + GAP_PX });
  const drape = await openFolder("./");
  const [[garment], motions, { joints }] = await Promise.all([drape.garments(), drape.motions(), drape.body()]);
  const shirt = await drape.wear(garment.id, { body: true, colours: [COLOUR], plain: stage.plain });
  const { figure } = shirt;
  const person = { rest: joints, crownM: new Box3().setFromBufferAttribute(figure.mesh.geometry.attributes.position).max.y };
  const dress = () => (figure.mesh.material = paintPerson(skinMaterial(TONE, { plain: stage.plain }), person));
  stage.onPlain = () => {
    shirt.setPlain(true);
    dress();
  };
  dress();
  stage.setHeight(person.crownM - joints[TOES[0]][1]);
  stage.scene.add(shirt);

  let last = performance.now();
  let tookMs = 0;
  shirt.addEventListener("frame", () => {
    const places = jointPlaces(shirt.bodyPose, shirt.root, joints);
    stage.follow(shirt.root, { ankles: ANKLES.map((joint) => places[joint]), toes: TOES.map((joint) => places[joint]) });
    const nowMs = performance.now();
    tookMs += 0.1 * (nowMs - last - tookMs);
    last = nowMs;
    document.body.dataset.frames = shirt.stats.frames;
  });
  setInterval(() => {
    status.textContent = `${garment.name}, no server: ${(1000 / Math.max(tookMs, 1)).toFixed(0)} frames a second, ${(1000 * shirt.stats.ageS).toFixed(0)} ms from pose to frame`;
  }, 500);

  const select = document.querySelector("select");
  select.append(...motions.map(({ id, name }) => new Option(name, id)));
  select.parentElement.hidden = motions.length < 2;
  select.addEventListener("change", () => shirt.play(select.value));
  if (motions.length) await shirt.play(motions[0].id);
  globalThis.shirt = shirt; // for whoever looks from the console
  stage.renderer.setAnimationLoop((now) => {
    stage.watch(now);
    stage.render();
  });
}

begin().catch((error) => {
  status.textContent = error.message;
  throw error;
});
