// Positions and normals of a garment from POSE messages: network, swing and folds, all computed here.
import { Decoder } from "./decode.js";
import { Folding } from "./folding.js";
import { PoseSupport } from "./pose_support.js";
import { unpackPose } from "./wire.js";

const WARM_UP = 6; // frames

export class LocalDecoder {
  // folder: { about, file }, its about.json and filesOf() its address; layers: as Decoder takes them, and folds as
  // Folding.make() does.
  static async make({ about, file }, layers, folds) {
    const { network, novelty } = about;
    const [bytes, poses] = await Promise.all([file(network.file), novelty && file(novelty.file)]);
    const folding = await Folding.make({ ...folds, network: bytes }, layers[0].layout);
    return new LocalDecoder(new Decoder(layers, folding), about, poses && new PoseSupport(poses, novelty));
  }

  constructor(decoder, about, support) {
    this.decoder = decoder;
    this.joints = about.joints;
    this.support = support;
    const took = [];
    const positions = new Float32Array(3 * decoder.folding.count);
    for (let i = 0; i < WARM_UP; i++) {
      const from = performance.now();
      const still = { pose: new Float32Array(72), root: [0, 0, 0], timeS: -1e9, steps: 0 };
      decoder.folding.drape(null, positions, { ...still, effort: { passes: about.opened.passes } });
      took.push(performance.now() - from);
    }
    took.sort((one, other) => one - other);
    this.told = { warmMs: took[WARM_UP >> 1] };
  }

  // Fills positions and normals, as Decoder.decode() does.
  decode(message, targets, { effort }) {
    const { pose, trans, client_time_s: timeS } = unpackPose(message);
    const root = this.joints[0].map((x, a) => x + trans[a]);
    const unlike = this.support !== null && this.support.novelty(pose) > 1;
    return this.decoder.pose({ pose, root, timeS, unlike }, targets, effort);
  }

  // The last frame holds, and is of the time [s].
  rest(timeS) {
    this.decoder.folding.rest(timeS);
  }
}
