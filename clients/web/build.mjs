// Bundles the page into dist (one script, one style sheet, one document), @drape/client into lib/dist, with the step of
// folds that lib/folds is compiled to, and the page that needs no service into static/dist (python -m service.static).
import asc from "assemblyscript/asc";
import { build } from "esbuild";
import { copyFile, mkdir, readFile, readdir, rename, rm, writeFile } from "node:fs/promises";
import { gzipSync } from "node:zlib";

const CORE_LIMIT = 40_000; // bytes, gzipped, of what an application gets beside three.js
const common = { bundle: true, format: "esm", target: "es2022", legalComments: "linked", logLevel: "warning" };

async function textOf(entry, options) {
  const { outputFiles } = await build({ ...common, minify: true, ...options, entryPoints: [entry], write: false, outdir: "." });
  return outputFiles.find(({ path }) => path.endsWith(".js")).text;
}

// Puts what fill(folder) makes in the place of target when all of it is there.
async function replace(target, fill) {
  const staged = `${target}.part`;
  await rm(staged, { recursive: true, force: true });
  await mkdir(staged);
  await fill(staged);
  await rm(target, { recursive: true, force: true });
  await rename(staged, target);
}

// The step of folds as WebAssembly with vector instructions.
async function foldsModule() {
  let binary = null;
  const files = { writeFile: (name, contents) => (binary = contents) };
  const options = ["--outFile", "folds.wasm", "--runtime", "stub", "-O3", "--noAssert", "--enable", "simd"];
  const { error, stderr } = await asc.main(["lib/folds/step.ts", ...options], files);
  if (error) throw new Error(`lib/folds: ${error.message}\n${stderr}`);
  return Buffer.from(binary);
}

const worker = await textOf("lib/src/worker.js", { format: "iife" });
const folds = await foldsModule();
const localWorker = await textOf("lib/src/local_worker.js", {});
const define = {
  WORKER_TEXT: JSON.stringify(worker),
  LOCAL_WORKER_TEXT: JSON.stringify(localWorker),
  FOLDS_TEXT: JSON.stringify(folds.toString("base64")),
};
const later = ["./folds.js"]; // what comes when it is needed

await replace("dist", async (folder) => {
  await build({ ...common, minify: true, define: { FOLDS_TEXT: define.FOLDS_TEXT }, splitting: true, chunkNames: "part-[hash]", entryPoints: ["src/boot.js"], outdir: folder });
  await writeFile(`${folder}/worker.js`, worker); // by address, since the page's policy takes no other scripts
  for (const name of ["index.html", "style.css", "icon.svg"]) await copyFile(`src/${name}`, `${folder}/${name}`);
  const [frame, script] = await Promise.all(["tracker.html", "tracker.js"].map((name) => readFile(`src/${name}`, "utf8")));
  await writeFile(`${folder}/tracker.html`, frame.replace('<script src="tracker.js"></script>', () => `<script>\n${script}</script>`));
});

const names = ["index", "core", "three", "react", "worker", "folds", "local", "local_worker"];
const entries = names.map((name) => `lib/src/${name}.js`);
const external = ["three", "three/*", "react"];
await replace("lib/dist", async (folder) => {
  await build({ ...common, define, external, splitting: true, entryPoints: entries, outdir: folder });
  for (const name of await readdir("lib/types")) await copyFile(`lib/types/${name}`, `${folder}/${name}`);
});
await replace("static/dist", async (folder) => {
  await build({ ...common, define, minify: true, entryPoints: ["static/page.js"], outdir: folder });
  await copyFile("static/index.html", `${folder}/index.html`);
});

const size = gzipSync(await textOf("lib/src/index.js", { define, external: [...external, ...later] })).length;
const step = (gzipSync(folds).length / 1000).toFixed(1);
console.log(`@drape/client: ${(size / 1000).toFixed(1)} kB gzipped, without three.js; folds, when they are asked for: ${step} kB`);
if (size > CORE_LIMIT) throw new Error(`@drape/client: expected ${CORE_LIMIT} bytes at most, got ${size}.`);
