// Positions and normals of a garment from POSE messages: network, jets and folds, all computed here.
import { Decoder } from "./decode.js";
import { Folding } from "./folding.js";
import { Network } from "./network.js";
import { unpackPose } from "./wire.js";

export class LocalDecoder {
  // folder, provider: as Network.open() takes them; layers, folds: as Decoder and Folding.make() do.
  static async make({ folder, provider }, layers, folds) {
    const folding = await Folding.make(folds);
    const network = await Network.open(folder, (pose) => folding.skin(pose), provider);
    return new LocalDecoder(new Decoder(layers, folding), network);
  }

  constructor(decoder, network) {
    this.decoder = decoder;
    this.network = network;
  }

  // Promises to fill positions and normals, as Decoder.decode() does.
  async decode(message, targets, { effort }) {
    const asked = unpackPose(message);
    const frame = await this.network.frame(asked, effort.motion);
    return this.decoder.fill(frame, targets, { pose: asked.pose, effort });
  }

  // The last frame holds, and is of the time [s].
  rest(timeS) {
    this.network.motion?.rested(timeS);
    this.decoder.folding.rest(timeS);
  }
}
