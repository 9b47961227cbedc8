// State and controls: which garment, which clip, which shape; plays the clip and counts what comes back.
import * as service from "./service.js";
import { Stream } from "./stream.js";
import { Viewer } from "./viewer.js";

const SHAPE_COUNT = 3;
const SEND_RATE = 60; // poses per second at most
const STATS_S = 0.5;
const SLOW_RATE = 20; // drawings per second below which the picture becomes plainer
const SLOW_WATCH_S = 1;
const SAVED_FPS = 30;
const wanted = new URLSearchParams(location.search); // garment, clip, quality=high
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
  onFrame(frame) {
    counts.frames += 1;
    counts.latest = frame;
  },
  onState(now, sentence) {
    document.body.dataset.state = now;
    // An open stream clears only what the stream has said itself.
    if (sentence) say(sentence, now === "refused", "stream");
    else if (spokenBy === "stream") say("");
  },
});

function openStream() {
  const garment = element("garment").value;
  if (garment) stream.open({ garment, betas: state.betas, push_out: element("push").checked });
}

const chooseGarment = failing(async () => {
  const garment = element("garment").value;
  if (!garment) return;
  const mesh = await service.garmentMesh(garment);
  if (garment !== element("garment").value) return; // another was chosen meanwhile
  counts.latest = null;
  viewer.setGarment(mesh);
  openStream();
});

// The shape matters: longer legs need another height.
const chooseClip = failing(async () => {
  const clip = await service.motion(element("clip").value, state.betas);
  clip.poses = clip.poses.map((pose) => pose.flat());
  if (clip.id !== state.clip?.id) state.timeS = 0;
  state.clip = clip;
});

const chooseShape = failing(async () => {
  const betas = [...state.betas];
  const file = await service.bodyFile(state.body, betas);
  await Promise.all([viewer.setBody(file), chooseClip()]);
  openStream();
});

async function listGarments(chosen) {
  const garments = await service.garments();
  const options = garments.map((g) => new Option(g.source === "user" ? `${g.name} (yours)` : g.name, g.id));
  element("garment").replaceChildren(...options);
  if (garments.length === 0) say("No garments yet: upload one.");
  if (chosen) element("garment").value = chosen;
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
  try {
    const words = { queued: "waits", running: "is being taken in" };
    const garment = await service.uploadGarment(file, element("avatar").value, (now) => say(`${file.name} ${words[now]} …`));
    await listGarments(garment);
    await chooseGarment();
    say(`${file.name} is ready.`);
  } finally {
    element("upload").disabled = false;
  }
});

const save = failing(async () => {
  const { clip } = state;
  const garment = element("garment").value;
  if (!clip || !garment) throw new Error("Choose a garment and a clip first.");
  element("save").disabled = true;
  say("The service writes the file …");
  try {
    const stride = Math.max(1, Math.round(clip.fps / SAVED_FPS));
    const kept = clip.poses.filter((_, frame) => frame % stride === 0);
    const poses = kept.map((pose) => Array.from({ length: 24 }, (_, joint) => pose.slice(3 * joint, 3 * joint + 3)));
    const trans = clip.trans.filter((_, frame) => frame % stride === 0);
    const document_ = { garment, poses, trans, betas: state.betas, fps: clip.fps / stride, push_out: element("push").checked, body: true };
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await service.clipFile(document_));
    link.download = `${garment}-${clip.id}.glb`;
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
      const frame = Math.floor(state.timeS * clip.fps) % clip.frames;
      stream.send(clip.poses[frame], clip.trans[frame]);
    }
  }
  const frame = counts.latest;
  if (frame) {
    counts.latest = null;
    if (viewer.show(frame)) {
      counts.shown += 1;
      counts.ageS = frame.ageS();
      counts.header = frame.header;
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
    element("pushed").textContent = header.flags & 1 ? `${(100 * header.pushed_share).toFixed(1)} %` : "off";
  }
  counts.shown = 0;
  counts.since = now;
}

function wireControls() {
  element("garment").addEventListener("change", chooseGarment);
  element("clip").addEventListener("change", chooseClip);
  element("push").addEventListener("change", openStream);
  element("colour").addEventListener("input", () => viewer.setColour(element("colour").value));
  element("body").addEventListener("change", () => viewer.setBodyShown(element("body").checked));
  element("wire").addEventListener("change", () => viewer.setTriangles(element("wire").checked));
  element("upload").addEventListener("click", upload);
  element("save").addEventListener("click", save);
  element("play").addEventListener("click", () => {
    state.playing = !state.playing;
    element("play").textContent = state.playing ? "Pause" : "Play";
  });
}

const start = failing(async () => {
  const health = await service.health();
  element("about").textContent = `model ${health.model}, ${health.provider.replace("ExecutionProvider", "")}, body ${health.body}`;
  state.body = health.body;
  viewer.setColour(element("colour").value);
  makeSliders();
  wireControls();
  const clips = await service.motions();
  element("clip").replaceChildren(...clips.map((clip) => new Option(`${clip.name} (${(clip.frames / clip.fps).toFixed(1)} s)`, clip.id)));
  if (wanted.has("clip")) element("clip").value = wanted.get("clip");
  else if (clips.some((clip) => clip.id === "walk")) element("clip").value = "walk";
  await listGarments(wanted.get("garment"));
  await Promise.all([chooseShape(), chooseGarment()]);
});

requestAnimationFrame(tick);
start();
