// The network of one garment on the engine: a posed body in, posed jets out.
export class Network {
  // engine: where its garment is draped; message: a FOLDS message with the network's records (service/static/site.py).
  constructor(engine, message) {
    const told = engine.lay(message);
    this.engine = engine;
    this.weights = engine.record("Weights", told.Weights);
    this.patches = engine.record("PatchRows", told.PatchRows);
    this.codeSize = told.Weights.from_body.bias.count;
  }

  // Writes the jets of a posed body, records both, after so many corrections.
  run(body, jets, passes) {
    const finite = this.engine.call("jets", this.weights, this.patches, body, BigInt(passes), jets);
    if (!finite) throw new Error("the network gave NaN or infinity");
  }
}
