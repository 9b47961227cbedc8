// The network of one garment on ONNX Runtime, which lies in the folder too: poses in, posed jets out.
import { Motion } from "./motion.js";
import { PoseSupport } from "./pose_support.js";
import { FLAG_UNLIKE } from "./wire.js";

const JOINTS = 24;
const WARM_UP = 6; // frames
const SLOW_MS = 16; // of a graphics card: a processor takes less

// Quaternions, w first, of the joints of a pose of 72 numbers [rad], and of one more that is not turned.
export function quaternionsOf(pose) {
  const quaternions = new Float32Array(4 * (JOINTS + 1));
  for (let joint = 0; joint < JOINTS; joint++) {
    const [x, y, z] = pose.slice(3 * joint, 3 * joint + 3);
    const angle = Math.hypot(x, y, z);
    const share = angle < 1e-8 ? 0.5 : Math.sin(0.5 * angle) / angle;
    quaternions.set([Math.cos(0.5 * angle), share * x, share * y, share * z], 4 * joint);
  }
  quaternions[4 * JOINTS] = 1;
  return quaternions;
}

// Why the graphics card is not taken, or nothing where it can be.
async function noCard(about) {
  if (!about.runtime.webgpu) return "the folder was written without WebGPU";
  if (!globalThis.navigator?.gpu) return "this browser has no WebGPU here";
  const adapter = await navigator.gpu.requestAdapter().catch(() => null);
  if (!adapter) return "there is no adapter";
  return (adapter.info?.isFallbackAdapter ?? adapter.isFallbackAdapter) ? "its adapter is software" : "";
}

export class Network {
  // folder: { base, about, file }, its address, about.json and filesOf(base); skin(pose): the posed samples of the skin;
  // provider: "webgpu" or "wasm", or "auto": the graphics card where there is one that is fast enough.
  static async open(folder, skin, provider = "auto") {
    const missing = provider === "auto" ? await noCard(folder.about) : "";
    if (provider === "wasm" || missing) return Network.#on("wasm", folder, skin, missing || "asked for");
    const network = await Network.#on("webgpu", folder, skin, provider === "auto" ? "found" : "asked for");
    const tookMs = network.told.warmMs;
    if (provider !== "auto" || tookMs <= SLOW_MS) return network;
    await network.close();
    return Network.#on("wasm", folder, skin, `the graphics card takes ${tookMs.toFixed(0)} ms`);
  }

  static async #on(provider, { base, about, file }, skin, why) {
    const { module, binary } = about.runtime[provider];
    const { network: files, joints } = about;
    const wanted = [binary, files.graph, files.motion, about.novelty?.file].map((name) => (name ? file(name) : null));
    const [ort, ...bytes] = await Promise.all([import(new URL(module, base).href), ...wanted]);
    const [wasm, graph, motion, poses] = bytes;
    ort.env.wasm.wasmBinary = wasm;
    ort.env.logLevel = "error";
    const opened = (model, where) => ort.InferenceSession.create(new Uint8Array(model), { executionProviders: [where], logSeverityLevel: 3 });
    const network = new Network(ort, await opened(graph, provider), skin);
    if (motion) network.motion = new Motion(joints, files, network.#advancing(await opened(motion, "wasm")));
    network.support = poses && new PoseSupport(poses, about.novelty);
    const took = [];
    for (let i = 0; i < WARM_UP; i++) {
      const from = performance.now();
      await network.run(new Float32Array(3 * JOINTS), new Float32Array(files.code));
      took.push(performance.now() - from);
    }
    took.sort((one, other) => one - other);
    network.told = { provider, why, threads: provider === "wasm" ? ort.env.wasm.numThreads || 1 : 1, warmMs: took[WARM_UP >> 1] };
    return network;
  }

  constructor(ort, session, skin) {
    this.ort = ort;
    this.session = session;
    this.skin = skin;
    this.motion = this.support = null;
    this.told = null; // provider, why, threads, and the median [ms] of the first frames
  }

  #advancing(session) {
    return async (features, state, dtS) => {
      const { Tensor } = this.ort;
      const found = await session.run({
        motion_features: new Tensor("float32", features, [1, JOINTS, features.length / JOINTS]),
        state: new Tensor("float32", state, [1, state.length]),
        dt_s: new Tensor("float32", Float32Array.of(dtS), [1]),
      });
      return { code: found.dynamic_code.data.slice(), state: found.next_state.data.slice() };
    };
  }

  // Promises the jets of a pose of 72 numbers [rad], as unpackJets() gives them. code: of the body's motion.
  async run(pose, code) {
    const { Tensor } = this.ort;
    const { inputNames } = this.session;
    const feeds = { joint_quaternion: new Tensor("float32", quaternionsOf(pose), [1, JOINTS + 1, 4]) };
    if (inputNames.includes("dynamic_code")) feeds.dynamic_code = new Tensor("float32", code, [1, code.length]);
    if (inputNames.includes("skin")) {
      const samples = this.skin(pose);
      feeds.skin = new Tensor("float32", samples, [1, samples.length / 96, 12, 8]);
    }
    const { jet, frame_rotation: rotation, frame_centre: centre } = await this.session.run(feeds);
    if (!centre.data.every(Number.isFinite)) throw new Error("the network gave NaN or infinity");
    return { jet: jet.data, rotation: rotation.data, centre: centre.data };
  }

  // Promises the frame of a POSE, as unpackJets() gives it. share: how much of motion counts, from 0 to 1.
  async frame({ pose, trans, client_time_s: timeS }, share = 1) {
    const code = share && this.motion ? await this.motion.next(pose, trans, timeS) : new Float32Array(this.motion?.sizes.code ?? 0);
    const jets = await this.run(pose, share === 1 ? code : code.map((number) => share * number));
    const flags = this.support && this.support.novelty(pose) > 1 ? FLAG_UNLIKE : 0;
    return { header: { count: jets.centre.length / 3, flags, client_time_s: timeS }, ...jets };
  }

  close() {
    return this.session.release();
  }
}
