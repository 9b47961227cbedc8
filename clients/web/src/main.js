// State and controls: which garments, clip and shape, how they are draped; plays the clip and counts what comes back.
import { clipFile, service, setKey, uploadGarment } from "./service.js";
import { clipSource, flatPose } from "../lib/src/sources.js";
import { Stream } from "../lib/src/stream.js";
import { topologyOf } from "../lib/src/topology.js";
import { FLAG_PUSHED, FLAG_STEPPED, FLAG_UNLIKE, MESH_SUFFIXES } from "../lib/src/wire.js";
import { Viewer } from "./viewer.js";
import { Wardrobe } from "./wardrobe.js";

const WORN = "trousers,tshirt"; // where the address names nothing, the innermost first
const SHAPE_COUNT = 3;
const SEND_RATE = 60; // poses per second at most
const STATS_S = 0.5;
const SLOW_RATE = 20; // drawings per second below which the picture becomes plainer
const SLOW_WATCH_S = 1;
const SAVED_FPS = 30;
const wanted = new URLSearchParams(location.search); // garment=inner,outer, clip, tier, passes, folds, resolution, fabric, jets, quality=high
const element = (id) => document.getElementById(id);
const state = { clip: null, timeS: 0, playing: true, betas: new Array(SHAPE_COUNT).fill(0), body: null };
const counts = { frames: 0, since: performance.now(), shown: 0, dropped: 0, droppedBefore: 0, latest: null };

let spokenBy = "user";
function say(sentence, bad = false, by = "user") {
  spokenBy = by;
  element("message").textContent = sentence;
  element("message").classList.toggle("bad", bad);
}

const failing = (task) => async (...values) => {
  try {
    await task(...values);
  } catch (error) {
    say(error.message, true);
  }
};

let viewer;
try {
  viewer = new Viewer(element("view"), { keepQuality: wanted.get("quality") === "high" });
} catch (error) {
  document.body.dataset.state = "failed";
  say(`This page needs WebGL 2, and the browser gave none (${error.message}).`, true);
  throw error;
}

const stream = new Stream({
  ticket: () => service.ticket(),
  onFrame(frame) {
    counts.frames += 1;
    counts.latest = frame;
  },
  onState(now, refusal) {
    document.body.dataset.state = now;
    // An open stream clears only what the stream has said itself.
    if (refusal) say(refusal.message, now === "refused", "stream");
    else if (spokenBy === "stream") say("");
  },
});

const wardrobe = new Wardrobe(element("layers"), element("add"), {
  onChange: () => chooseGarments(),
  onColour: (layer, colour) => viewer.setColour(layer, colour),
});

// What a request says of garments and of how they are draped.
function scene() {
  const garments = wardrobe.chosen();
  const worn = garments.length === 1 ? { garment: garments[0] } : { garments };
  return { ...worn, betas: state.betas, ...options() };
}

// Options (drape/wire/options.py) are the controls that name one; an empty one is left to the service.
const WORDS = ["fabric", "resolution", "tier"]; // the others are numbers
const optionControls = () => [...document.querySelectorAll("[data-option]")];

function options() {
  const chosen = optionControls().filter((control) => control.type === "checkbox" || control.value !== "");
  const value = (control) => {
    if (control.type === "checkbox") return control.checked;
    return WORDS.includes(control.dataset.option) ? control.value : Number(control.value);
  };
  return Object.fromEntries(chosen.map((control) => [control.dataset.option, value(control)]));
}

function openStream() {
  const garments = wardrobe.chosen();
  if (!garments.length) return;
  if (garments.length > 1 && element("push").checked) say("The outfit is being made ready …", false, "stream");
  // Folds are of vertices: polynomials are smooth.
  stream.open(element("jets").checked ? { ...scene(), geometry: "jets", folds: undefined } : scene());
}

// What never changes of a garment is fetched once.
const kept = new Map();
function once(key, fetching) {
  if (!kept.has(key)) {
    kept.set(key, fetching());
    kept.get(key).catch(() => kept.delete(key));
  }
  return kept.get(key);
}

const resolution = () => element("resolution").value || "delivered";
const meshOf = (id) =>
  once(`mesh ${id} ${resolution()}`, async () => topologyOf(await service.garmentMesh(id, resolution())));
const layoutOf = (id) => once(`jets ${id} ${resolution()}`, () => service.jetLayout(id, resolution()));

const chooseGarments = failing(async () => {
  const chosen = wardrobe.chosen();
  if (!chosen.length) return;
  const jets = element("jets").checked;
  const asked = () => `${wardrobe.chosen()} ${element("jets").checked} ${resolution()}`;
  const before = asked();
  const worn = await Promise.all(
    chosen.map(async (id) => {
      const [topology, layout] = await Promise.all([meshOf(id), jets ? layoutOf(id) : null]);
      return { ...topology, layout };
    }),
  );
  if (before !== asked()) return; // changed meanwhile
  counts.latest = null;
  viewer.setGarments(worn.map((layer, i) => ({ ...layer, colour: wardrobe.colours()[i] })));
  openStream();
});

// The shape matters: longer legs need another height.
const chooseClip = failing(async () => {
  const clip = await service.motion(element("clip").value, state.betas);
  clip.poses = clip.poses.map(flatPose);
  clip.sample = clipSource(clip);
  if (clip.id !== state.clip?.id) state.timeS = 0;
  state.clip = clip;
});

const chooseShape = failing(async () => {
  const betas = [...state.betas];
  const file = await service.bodyFile(state.body, betas);
  await Promise.all([viewer.setBody(file), chooseClip()]);
  openStream();
});

async function listGarments(chosen, limit) {
  const garments = await service.garments();
  wardrobe.offer(garments, chosen, limit);
  if (garments.length === 0) say("No garments yet: upload one.");
}

function listPasses(count) {
  const counts = Array.from({ length: count + 1 }, (_, i) => count - i);
  const names = counts.map((passes) => new Option(passes === 0 ? "none" : String(passes), String(passes)));
  element("passes").replaceChildren(new Option("as the quality", ""), ...names);
  element("passes-row").hidden = count === 0; // the model leaves no choice
  const asked = wanted.get("passes");
  if (asked !== null && counts.includes(Number(asked))) element("passes").value = asked;
}

// What was measured of a tier stands beside its name.
async function listTiers() {
  const tiers = await service.tiers();
  const percent = ({ figures }) => (figures.gain === undefined ? "" : `, ${(100 * figures.gain).toFixed(0)} % of physics`);
  element("tier").replaceChildren(...tiers.map((tier) => new Option(`${tier.id}${percent(tier)}`, tier.id)));
  element("tier").value = tiers.find((tier) => tier.default).id;
  const asked = wanted.get("tier");
  if (tiers.some(({ id }) => id === asked)) element("tier").value = asked;
}

async function listFabrics(known) {
  element("fabric-row").hidden = !known; // the model leaves no choice
  if (!known) return;
  const names = (await service.fabrics()).map(({ id }) => new Option(id.replace("_", " "), id));
  element("fabric").replaceChildren(new Option("each garment's own", ""), ...names);
  const asked = wanted.get("fabric");
  if (names.some((name) => name.value === asked)) element("fabric").value = asked;
}

function makeSliders() {
  for (let i = 0; i < SHAPE_COUNT; i++) {
    const slider = Object.assign(document.createElement("input"), { type: "range", min: -2, max: 2, step: 0.1, value: 0 });
    const label = document.createElement("label");
    label.className = "inline";
    label.append(`${i + 1}`, slider);
    slider.addEventListener("change", () => {
      state.betas[i] = Number(slider.value);
      chooseShape();
    });
    element("shapes").append(label);
  }
}

const upload = failing(async () => {
  const file = element("file").files[0];
  if (!file) throw new Error("Choose a garment file first: OBJ, GLB, PLY or STL.");
  element("upload").disabled = true;
  const ending = new AbortController();
  element("cancel").hidden = false;
  element("cancel").onclick = () => ending.abort();
  try {
    const words = { start: "begins", read: "is read", rest: "is laid on the body", fit: "gets its patches", cloth: "comes to rest", store: "is stored", prepare: "is made ready" };
    const told = (job) => say(`${file.name} ${words[job.stage] ?? "waits"} … ${Math.round(100 * job.share)} %`);
    const garment = await uploadGarment(file, element("avatar").value, told, ending.signal);
    await listGarments([...wardrobe.chosen().slice(0, -1), garment]);
    await chooseGarments();
    say(`${file.name} is ready.`);
  } finally {
    element("cancel").hidden = true;
    element("upload").disabled = false;
  }
});

const save = failing(async () => {
  const { clip } = state;
  const garments = wardrobe.chosen();
  if (!clip || !garments.length) throw new Error("Choose a garment and a clip first.");
  element("save").disabled = true;
  say("The service writes the file …");
  try {
    const stride = Math.max(1, Math.round(clip.fps / SAVED_FPS));
    const kept = clip.poses.filter((_, frame) => frame % stride === 0);
    const poses = kept.map((pose) => Array.from({ length: 24 }, (_, joint) => pose.slice(3 * joint, 3 * joint + 3)));
    const trans = clip.trans.filter((_, frame) => frame % stride === 0);
    const document_ = { ...scene(), poses, trans, fps: clip.fps / stride, body: true };
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await clipFile(document_));
    link.download = `${garments.join("-")}-${clip.id}.glb`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    say(`Saved ${link.download}.`);
  } finally {
    element("save").disabled = false;
  }
});

let lastTick = performance.now();
let lastSent = 0;
const slow = { ticks: 0, since: lastTick };
function tick(now) {
  requestAnimationFrame(tick);
  const stepS = Math.min((now - lastTick) / 1000, 0.25);
  lastTick = now;
  watchSpeed(now);
  const { clip } = state;
  if (clip) {
    if (state.playing) state.timeS += stepS * Number(element("speed").value);
    if (now - lastSent >= 1000 / SEND_RATE - 2) {
      lastSent = now;
      const { poses, trans } = clip.sample(state.timeS);
      stream.send(poses, trans);
    }
  }
  const frame = counts.latest;
  if (frame) {
    counts.latest = null;
    if (viewer.show(frame)) {
      counts.shown += 1;
      counts.ageS = frame.ageS();
      counts.header = frame.header;
      counts.bytes = frame.bytes;
      document.body.dataset.frames = String(Number(document.body.dataset.frames) + 1);
    }
  }
  viewer.render();
  if (now - counts.since >= 1000 * STATS_S) showStats(now);
}

// A machine without a graphics card draws slowly: it gets a plainer picture, not fewer frames.
function watchSpeed(now) {
  slow.ticks += 1;
  if (now - slow.since < SLOW_WATCH_S * 1000) return;
  if (slow.ticks < SLOW_RATE * SLOW_WATCH_S && document.visibilityState === "visible") viewer.simplify();
  slow.ticks = 0;
  slow.since = now;
}

function showStats(now) {
  const { header } = counts;
  element("fps").textContent = (counts.shown / ((now - counts.since) / 1000)).toFixed(0);
  if (header) {
    element("age").textContent = `${(1000 * counts.ageS).toFixed(0)} ms`;
    element("residence").textContent = `${(header.residence_us / 1000).toFixed(0)} ms`;
    element("dropped").textContent = String(header.dropped);
    const unlike = header.flags & FLAG_UNLIKE ? ", more folds: a pose unlike training" : "";
    element("quality").textContent = header.flags & FLAG_STEPPED ? `less than ${stream.opened.tier}, under load` : stream.opened.tier + unlike;
    element("pushed").textContent = header.flags & FLAG_PUSHED ? `${(100 * header.pushed_share).toFixed(1)} %` : "off";
    element("bytes").textContent = `${(counts.bytes / 1000).toFixed(1)} kB`;
    element("left-row").hidden = header.left_m === undefined;
    element("left").textContent = `${(1000 * (header.left_m ?? 0)).toFixed(1)} mm`;
  }
  counts.shown = 0;
  counts.since = now;
}

function wireControls() {
  element("clip").addEventListener("change", chooseClip);
  for (const control of optionControls()) {
    control.addEventListener("change", control.id === "resolution" ? chooseGarments : openStream);
  }
  element("jets").addEventListener("change", chooseGarments);
  element("body").addEventListener("change", () => viewer.setBodyShown(element("body").checked));
  element("wire").addEventListener("change", () => viewer.setTriangles(element("wire").checked));
  element("file").accept = MESH_SUFFIXES;
  element("upload").addEventListener("click", upload);
  element("save").addEventListener("click", save);
  element("play").addEventListener("click", () => {
    state.playing = !state.playing;
    element("play").textContent = state.playing ? "Pause" : "Play";
  });
}

// A service with keys says nothing to who has none.
function askForKey(error) {
  if (error.status === 401) {
    document.body.dataset.state = "locked";
    element("about").textContent = "This service asks for a key.";
    element("door").hidden = false;
    element("key").focus();
  }
  throw error;
}

element("door").addEventListener("submit", (event) => {
  event.preventDefault();
  setKey(element("key").value.trim());
  location.reload();
});

const start = failing(async () => {
  const health = await service.health().catch(askForKey);
  element("about").textContent = `model ${health.model}, ${health.provider.replace("ExecutionProvider", "")}, body ${health.body}`;
  state.body = health.body;
  listPasses(health.passes);
  await listTiers();
  await listFabrics(health.fabrics);
  element("jets").checked = wanted.has("jets");
  if (wanted.has("folds")) element("folds").value = wanted.get("folds");
  if (wanted.get("resolution") === "fine") element("resolution").value = "fine";
  makeSliders();
  wireControls();
  const clips = await service.motions();
  element("clip").replaceChildren(...clips.map((clip) => new Option(`${clip.name} (${(clip.frames / clip.fps).toFixed(1)} s)`, clip.id)));
  if (wanted.has("clip")) element("clip").value = wanted.get("clip");
  else if (clips.some((clip) => clip.id === "walk")) element("clip").value = "walk";
  await listGarments((wanted.get("garment") ?? WORN).split(","), health.layers);
  await Promise.all([chooseShape(), chooseGarments()]);
});

requestAnimationFrame(tick);
start();
