// An application that has installed the package: type-checked in strict mode, then run against a service.
import { DrapeError, connect, type Drape, type Motion, type Worn } from "@drape/client";
import { connect as connectCore, type WearOptions, type Wearing } from "@drape/client/core";
import { openFolder, type LocalDrape } from "@drape/client/local";
import { rigSource } from "@drape/client/three";
import { Mesh, Object3D, Scene } from "three";

declare const process: { argv: string[]; exit(status: number): never };
const url: string = process.argv[2] ?? "";

const refusalOf = async (task: () => Promise<unknown>): Promise<DrapeError | null> => {
  try {
    await task();
    return null;
  } catch (error) {
    if (error instanceof DrapeError) return error;
    throw error;
  }
};

const drape: Drape = await connect(url);
const tube: Worn = await drape.wear("tube", { tier: "fast", colours: ["#2f6fb0"] });
const scene = new Scene().add(tube);
const framed = () => new Promise<void>((resolve) => tube.addEventListener("frame", () => resolve()));

await tube.play("reach", { speed: 2 });
await framed();
const mesh: Mesh = tube.mesh;
const positions = Array.from(mesh.geometry.attributes.position!.array);

const own: Motion = await drape.motion("squat");
await tube.follow((timeS) => ({ poses: own.poses[0]!, trans: [0, timeS > 1 ? 0 : 0.5, 0] }));
await framed();

const refused = await refusalOf(() => tube.set({ passes: 65 }));
await framed(); // what was refused has changed nothing
const unknown = await refusalOf(() => drape.wear("nothing"));
const noRig = await refusalOf(async () => rigSource(new Object3D()));
const noFolder = await refusalOf(async (): Promise<LocalDrape> => openFolder(`${url}/health`));
const garments = (await drape.garments()).map(({ id }) => id);
tube.dispose();

const core = await connectCore(url, { worker: null });
const headless: Wearing = await core.wear(["tube"], { geometry: "jets" });
const [root, jets] = await new Promise<[number[], Float32Array]>((resolve) => {
  headless.onFrame = ({ root, positions }) => positions && resolve([root, positions[0]!]);
  void headless.play("reach");
});
headless.close();

// The same poses in turn: as the service folds them, and as this program does.
const drapeBoth = async (options: WearOptions): Promise<[string, number[]]> => {
  const worn = await core.wear("tube", { folds: 1, ...options });
  await worn.set({ fabric: "denim" });
  for (let frame = 0; frame < 3; frame++) {
    const shown = new Promise<void>((resolve) => (worn.onFrame = () => resolve()));
    worn.pose(own.poses[0]!);
    await shown;
  }
  const found: [string, number[]] = [worn.foldsBy, Array.from(worn.positions![0]!)];
  worn.close();
  return found;
};
const [server, client] = [await drapeBoth({}), await drapeBoth({ folds_by: "client" })];
const several = await core.wear("tube", { colliders: [{ kind: "plane" }], folds: 1, folds_by: "auto" });
const fallen = several.foldsBy;
several.close();
const alone = await refusalOf(() => core.wear("tube", { colliders: [{ kind: "plane" }], folds: 1, folds_by: "client" }));

const told = (error: DrapeError | null) => error && [error.name, error.kind, error.status, error.cure !== ""];
console.log(
  JSON.stringify({
    garments, root, positions, jets: Array.from(jets), state: tube.state, children: scene.children.length, frames: tube.stats.frames,
    refused: told(refused), unknown: told(unknown), noRig: told(noRig), noFolder: told(noFolder), server, client, fallen, alone: told(alone),
  }),
);
process.exit(0);
