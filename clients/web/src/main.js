// The fitting room: what its parts have to do with each other.
import { connect } from "../lib/src/index.js";
import { clipSource } from "../lib/src/sources.js";
import { BESIDE_SUFFIXES, BYTES, MESH_SUFFIXES } from "../lib/src/wire.js";
import { findCharacter, sendCharacter } from "./avatars.js";
import { Camera, makeDoor } from "./camera.js";
import { askForKey } from "./door.js";
import { acceptDrops, chosenGarments } from "./drop.js";
import { Fabrics } from "./fabrics.js";
import { Figure } from "./figure.js";
import { asked, clipFirst, countFrame, moving, wanted, wornFirst } from "./first.js";
import { Fit } from "./fit.js";
import { listen, makeDrawers, makeHelp, makeSheet, turnByKeys } from "./keys.js";
import { Measures } from "./measures.js";
import { Motions } from "./motions.js";
import { Outfit } from "./outfit.js";
import { OwnClothes } from "./own_clothes.js";
import { OwnMotions } from "./own_motions.js";
import { Quality } from "./quality.js";
import { Readouts, Triangles } from "./readouts.js";
import { key } from "./service.js";
import { Shelf } from "./shelf.js";
import { Sizes } from "./sizes.js";
import { Stage } from "./stage.js";
import { Uploads } from "./uploads.js";
import { VMC, Vmc } from "./vmc.js";
import { element, failing, hush, say, tellOffline, title } from "./words.js";

const SEND_RATE = 60; // poses per second at most
const SHEET_PX = 760; // as in style.css
const state = { betas: [], avatar: null };

let drape = null;
let stage = null; // while the first answers are waited for
let figure = null;
let outfit = null;
let fit = null;
let measures = null;
const triangles = new Triangles();
const quality = new Quality({ onChange: () => wearAgain(), onFolds: () => wearAgain() });
const shelf = new Shelf({
  onChange: () => wearAgain(),
  onColour(id, colour) {
    outfit?.colour(id, colour);
    fabrics.draw();
  },
  onSelect: () => drawGarment(),
  async picture(garment, size) {
    await moving; // cloth comes first
    return drape.rest.picture(`/garments/${encodeURIComponent(garment.id)}/preview.png?size=${size}&alone=true`);
  },
});
const ownClothes = new OwnClothes({
  onChange(on) {
    shelf.undress(on ? 0 : 1);
    wearAgain();
  },
});
const fabrics = new Fabrics(shelf, { onFabric: () => wearAgain() });
const sizes = new Sizes(shelf, {
  onSize: () => (say("The size is cut …", { by: "stream" }), wearAgain()),
  advice: async (id) => (state.avatar === null ? drape.rest.size(id, state.betas) : null), // characters have no measures
});

// The drawer that is about the selected garment.
function drawGarment() {
  fabrics.draw();
  sizes.draw();
}
const motions = new Motions({ load: failing((id) => loadClip(id)) });
const readouts = new Readouts({
  onOption: () => wearAgain(),
  onMesh: () => wearAgain(),
  onBody: (shown) => figure.setShown(shown),
  onTriangles(shown) {
    triangles.show(shown);
    stage.dirty = true;
  },
});

// How what is worn is draped, by the names of the wire; "undefined" is left to the service.
function options() {
  const { resolution, advanced, ...chosen } = readouts.options();
  if (element("jets").checked) delete advanced.folds; // they are of vertices: polynomials are smooth
  const shape = state.avatar === null ? { betas: state.betas } : {};
  return { ...shape, tier: quality.tier, ...chosen, advanced, ...fabrics.option() };
}

// What needs other meshes or another wearer.
function meshed() {
  const { resolution } = readouts.options();
  const jets = element("jets").checked ? { geometry: "jets" } : {};
  return { ...(resolution ? { resolution } : {}), ...jets, ...quality.folds, ...sizes.option(), ...ownClothes.option(), ...(state.avatar === null ? {} : { avatar: state.avatar }) };
}

const wearAgain = failing(async () => {
  if (shelf.worn.length < shelf.least) return;
  if (shelf.worn.length > 1 && element("push").checked) say("The outfit is being made ready …", { by: "stream" });
  fit?.wash(); // what is worn gets its own look before it changes
  try {
    if (!(await outfit.wear(shelf.worn, options(), meshed()))) return;
  } catch (error) {
    if (error.kind === "Unavailable") tellOffline(error);
    throw error;
  }
  tellOffline(null);
  hush("stream");
  if (fit?.on) await fit.show(outfit.next ?? outfit.current, true);
});

const ownMotions = new OwnMotions(motions, () => drape.rest);
const takeMotion = failing((file) => ownMotions.take(file));

const CAMERA = "camera"; // the id of the motion of whoever stands before it
const camera = new Camera({
  onWords: (sentence, bad) => (sentence ? say(sentence, { bad, by: CAMERA }) : hush(CAMERA)),
  onEnd: () => leaveCamera(),
});

const takeTracker = failing(async (files) => {
  say("The tracker is loaded …", { by: CAMERA });
  if (motions.wanted === CAMERA) await leaveCamera();
  await camera.take(files);
  if (!motions.clips.some(({ id }) => id === CAMERA)) motions.offer([...motions.clips, { id: CAMERA, name: "Camera" }], motions.wanted);
  await chooseCamera();
});

// Another motion, for one that does not go on.
const leaveCamera = () => motions.choose(motions.clips.find(({ id }) => ![CAMERA, VMC].includes(id)).id);

// The camera, or the choice of a tracker where there is none; one that does not start leaves the motion that was.
async function chooseCamera() {
  if (!camera.ready) {
    cameraDoor.showModal();
    return;
  }
  await motions.choose(CAMERA);
}

const cameraDoor = makeDoor(takeTracker);

const vmc = new Vmc(motions, () => leaveCamera());
const chooseVmc = () => {
  cameraDoor.close();
  return vmc.choose();
};

async function loadClip(id) {
  if (id === CAMERA) return { id, ...(await camera.motion(drape, { betas: state.betas, avatar: state.avatar ?? undefined })) };
  if (id === VMC) return vmc.load(await drape.body(state.betas, state.avatar));
  if (ownMotions.has(id)) return ownMotions.load(id, await drape.body(state.betas, state.avatar));
  const clip = await drape.motion(id, state.betas, state.avatar);
  return { ...clip, id, sample: clipSource(clip) };
}

// The shape matters to all: longer legs need another height.
async function changeShape(betas) {
  state.betas = betas;
  await changeWearer();
}

// Who wears it comes with the first frame of what is cut for them: { for, figure } until then.
let coming = null;
const wearerOf = ({ avatar = null, betas = [] }) => JSON.stringify([avatar, avatar === null ? betas : []]);

// about: what the service tells of the avatar.
async function bringWearer(about) {
  const { avatar, betas } = state;
  const made = avatar === null ? await figure.makeBody(await drape.rest.bodyFile(drape.health.body, betas)) : await findCharacter(about);
  if (made.object) await stage.ready(made.object);
  if (wearerOf(state) !== wearerOf({ avatar, betas })) return; // changed meanwhile
  sizes.draw(); // another body may take another
  coming = { for: wearerOf(state), figure: made };
}

async function changeWearer(about) {
  await bringWearer(about);
  await Promise.all([motions.wanted && motions.choose(motions.wanted), wearAgain()]);
}

// id: of an avatar, or null for the service's body.
const chooseCharacter = failing(async (id) => {
  if (fit.on) await fit.show(outfit.current, false);
  state.avatar = id;
  const avatars = await drape.avatars();
  measures.listCharacters(avatars, id);
  if (id !== null) say("The garments are cut for the character …", { by: "cut" });
  const about = avatars.find((one) => one.id === id) ?? null;
  ownClothes.offer(about, true);
  shelf.undress(ownClothes.option().alive ? 0 : 1);
  await changeWearer(about);
  hush("cut");
  if ((coming?.figure ?? figure).object === null) say("This browser does not have the character's file: drop it again to see it.");
});

const takeCharacter = failing(async (file) => {
  say(`${file.name} is looked at: its skeleton, its skin, its clothes …`);
  const id = await sendCharacter(drape, file);
  say(`${file.name} is ready.`);
  await ownMotions.offer(file);
  await chooseCharacter(id);
});

async function take({ kind, parts }) {
  const [{ file }] = parts;
  if (kind === "garment") await uploads.take(parts);
  else if (kind === "character") await takeCharacter(file);
  else if (kind === "motion") await takeMotion(file);
  else if (kind === "beside") say(`${file.name} belongs to a garment: drop it together with its mesh.`, { bad: true });
  else say(`${file.name} is none of OBJ, GLB, PLY, STL, USD, FBX, ZIP (garments), GLB, VRM (characters), BVH, NPZ, VRMA, GLB, FBX (motions).`, { bad: true });
}

// Skin below, and own clothes that are cloth now or come off, change with the first picture of what is worn.
const cover = failing(async (worn) => {
  const { options } = worn.wearing;
  const { object } = coming?.for === wearerOf(options) ? coming.figure : figure;
  if (options.avatar && object && worn.covering?.skin !== object) await worn.cover(object);
});

function makeOutfit() {
  outfit = new Outfit(drape, stage, {
    onOpen: cover,
    onFrame(worn) {
      const { wearing } = worn;
      triangles.draw(worn);
      worn.visible = figure.rest !== undefined || coming !== null; // nobody else has to come yet
      if (!worn.visible) return;
      if (coming && coming.for === wearerOf(wearing.options)) {
        figure.show(coming.figure);
        coming = null;
      }
      cover(worn);
      const moved = wearing.stats.bytes > BYTES.SAME || !figure.posed; // else nothing has to be drawn
      if (moved) figure.pose(wearing.bodyPose, wearing.root);
      quality.take(wearing);
      readouts.take(wearing);
      framed = true;
    },
    onFolds: ({ tookS, allowedS }) =>
      say(`The service makes the folds: here a frame took ${(1000 * tookS).toFixed(0)} ms, and ${(1000 * allowedS).toFixed(0)} keep up.`, { by: "folds" }),
    onState(now, refusal) {
      document.body.dataset.state = now;
      tellOffline(now === "waiting" ? refusal : null);
      if (now === "waiting") return;
      if (refusal) say(refusal.message, { bad: true, by: "stream" });
      else hush("stream");
    },
  });
  element("retry").addEventListener("click", failing(() => (outfit.next ?? outfit.current ? outfit.retry() : wearAgain())));
}

async function listGarments(chosen, limit) {
  const garments = await drape.garments();
  shelf.offer(garments, wornFirst(garments, limit ?? shelf.limit, chosen), limit);
  if (garments.length === 0) say("No garments yet: upload one.");
}

const uploads = new Uploads({
  rest: () => drape.rest,
  async onMade(garments, instead) {
    const before = shelf.worn.map(({ id }) => id).filter((id) => !instead.includes(id));
    const under = garments.length > 1 ? [] : before.slice(0, shelf.limit - 1); // an outfit is worn by itself
    await listGarments([...under, ...garments]);
    await wearAgain();
  },
});

const save = failing(async () => {
  const { clip } = motions;
  if (!clip?.frames || shelf.worn.length < shelf.least) throw new Error("Choose a garment and a motion first; what the camera sees is not kept.");
  element("save").disabled = true;
  try {
    const { saveMotion } = await import("./save.js");
    await saveMotion(drape, outfit.next ?? outfit.current, { garments: shelf.worn.map(({ id }) => id), ...options(), ...meshed() }, clip);
  } finally {
    element("save").disabled = false;
  }
});

const showFit = failing(async () => {
  if (state.avatar !== null && !fit.on) throw new Error("Fit is measured on our body: choose it in the drawer Body first.");
  await fit.show(outfit.current, !fit.on);
});

let lastTick = performance.now();
let lastSent = 0;
let framed = false; // whether a frame has come since the last picture
function tick(now) {
  requestAnimationFrame(tick);
  const stepS = Math.min((now - lastTick) / 1000, 0.25);
  lastTick = now;
  const pose = motions.pose(stepS);
  if (pose && outfit && now - lastSent >= 1000 / SEND_RATE - 2) {
    lastSent = now;
    outfit.pose(pose.poses, pose.trans);
  }
  if (framed) countFrame(); // is drawn now
  framed = false;
  if (outfit?.current) stage.render(); // before there is a picture
  stage.watch(now);
  readouts.tell(now);
  quality.tell();
}

function makeStage() {
  try {
    stage = new Stage(element("view"), { keepQuality: wanted.get("quality") === "high" });
  } catch (error) {
    document.body.dataset.state = "failed";
    throw error;
  }
  figure = new Figure(stage);
  stage.onPlain = () => {
    figure.setPlain();
    outfit?.setPlain();
  };
  new ResizeObserver(makeRoom).observe(element("shelf"));
  new ResizeObserver(makeRoom).observe(element("dock"));
  addEventListener("resize", makeRoom);
}

function makeFit() {
  fit = new Fit(drape.rest, stage, {
    request(id) {
      const { fabric, size } = shelf.worn.find((one) => one.id === id) ?? {};
      return { betas: state.betas, fabric: fabric ?? undefined, size: size ?? undefined };
    },
    name: (id) => title(shelf.garment(id).name),
  });
}

// The person stands in what controls leave free.
function makeRoom() {
  const shelfBox = element("shelf").getBoundingClientRect();
  const sheet = innerWidth <= SHEET_PX;
  const bar = element("dock").getBoundingClientRect();
  stage.setInsets({ left: 0, top: sheet ? 96 : 40, right: sheet ? 0 : innerWidth - shelfBox.left, bottom: innerHeight - bar.top + 12 });
}

function wireControls() {
  element("file").accept = `${MESH_SUFFIXES},${BESIDE_SUFFIXES}`;
  const single = (taker) => (files) => taker(files[0]);
  const several = async (files) => {
    for (const thing of await chosenGarments(files)) await take(thing);
  };
  for (const [id, taker] of [["file", several], ["character-file", single(takeCharacter)], ["motion-file", single(takeMotion)]]) {
    element(id).addEventListener("change", async () => {
      const { files } = element(id);
      if (files.length) await taker(files);
      element(id).value = ""; // so that the same one may come again
    });
  }
  acceptDrops(take);
  element("save").addEventListener("click", save);
  element("fit").addEventListener("click", showFit);
  element("camera-open").addEventListener("click", chooseCamera);
  element("vmc").addEventListener("click", chooseVmc);
  listen({
    " ": () => motions.setPlaying(!motions.playing), "[": () => motions.step(-1), "]": () => motions.step(1),
    "1": () => quality.choose(0), "2": () => quality.choose(1), "3": () => quality.choose(2), "4": () => quality.choose(3),
    c: chooseCamera, v: chooseVmc, f: showFit, s: save, d: () => readouts.toggle(), b: () => element("body").click(), 0: () => stage.fit(), "?": () => element("help").showModal(),
  });
  turnByKeys(element("view"), stage);
}

const start = failing(async () => {
  const worker = () => new Worker("worker.js");
  const connecting = connect(location.origin, { key, worker, fetch: asked });
  makeStage();
  drape = await connecting.catch(askForKey);
  const { health } = drape;
  element("about").textContent = `model ${health.model}, ${health.provider.replace("ExecutionProvider", "")}, body ${health.body}, version ${health.version}`;
  makeOutfit();
  measures = new Measures(drape.rest, { onShape: changeShape, onTone: (tone) => figure.setTone(tone), onCharacter: chooseCharacter });
  readouts.offer(wanted, health.passes);
  const others = Promise.all([drape.avatars(), measures.offer(health.body)]);
  const [tiers, list, clips] = await Promise.all([drape.tiers(), drape.fabrics(), drape.motions(), listGarments(undefined, health.layers)]);
  quality.offer(tiers, wanted.get("tier"), wanted.get("folds_by"));
  const fabric = wanted.get("fabric");
  sizes.wear(wanted.get("size"));
  if (list.some(({ id }) => id === fabric)) for (const layer of shelf.worn) layer.fabric = fabric;
  fabrics.offer(list, health.fabrics);
  const named = clipFirst(clips);
  motions.offer(clips, named);
  const begun = [wearAgain(), named && motions.choose(named)];
  makeFit();
  requestAnimationFrame(tick);
  const [avatars] = await others;
  measures.listCharacters(avatars, null);
  wireControls();
  await Promise.all([...begun, bringWearer()]);
});

makeDrawers();
makeHelp();
makeSheet();
start();
