// Bundles the page into dist (one script, one style sheet, one document), @drape/client into lib/dist, with the engine that
// python -m drape.engine.build --wasm compiles, and the page that needs no service into static/dist (python -m service.static).
import { build } from "esbuild";
import { copyFile, mkdir, readFile, readdir, rename, rm, writeFile } from "node:fs/promises";
import { basename } from "node:path";
import { brotliCompressSync, gzipSync } from "node:zlib";

const ENGINE = "../../drape/engine/libraries/engine.wasm";
const CORE_LIMIT = 40_000; // bytes, gzipped, of what an application gets beside three.js
const ENGINE_LIMIT = 150_000;
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

// Lays what is text in a folder beside it compressed, as a service sends it.
async function compress(folder) {
  for (const name of await readdir(folder)) {
    if (!/\.(js|css|html|svg)$/.test(name)) continue;
    const bytes = await readFile(`${folder}/${name}`);
    for (const [suffix, packed] of [["br", brotliCompressSync(bytes)], ["gz", gzipSync(bytes, { level: 9 })]]) {
      if (packed.length < bytes.length) await writeFile(`${folder}/${name}.${suffix}`, packed);
    }
  }
}

const worker = await textOf("lib/src/worker.js", { format: "iife" });
const engine = gzipSync(await readFile(ENGINE), { level: 9 });
const localWorker = await textOf("lib/src/local_worker.js", {});
const define = {
  WORKER_TEXT: JSON.stringify(worker),
  LOCAL_WORKER_TEXT: JSON.stringify(localWorker),
  ENGINE_TEXT: JSON.stringify(engine.toString("base64")),
};
const later = ["./bare.js", "./folds.js", "./folding.js"]; // what comes when it is needed

// Links that let scripts begin to load with the document: those that entry imports, in a build's metafile.
function preloads({ outputs }, entry) {
  const names = new Set(Object.keys(outputs).filter((name) => outputs[name].entryPoint === entry));
  for (const name of names) for (const { path, kind } of outputs[name].imports) if (kind === "import-statement") names.add(path);
  return [...names].map((name) => `<link rel="modulepreload" href="${basename(name)}" fetchpriority="low" />`).join("\n    ");
}

await replace("dist", async (folder) => {
  const { metafile } = await build({ ...common, minify: true, define: { ENGINE_TEXT: define.ENGINE_TEXT }, metafile: true, splitting: true, chunkNames: "part-[hash]", entryPoints: ["src/boot.js"], outdir: folder });
  await writeFile(`${folder}/worker.js`, worker); // by address, since the page's policy takes no other scripts
  for (const name of ["style.css", "icon.svg", "poster.webp"]) await copyFile(`src/${name}`, `${folder}/${name}`);
  const page = await readFile("src/index.html", "utf8");
  await writeFile(`${folder}/index.html`, page.replace("  </head>", () => `    ${preloads(metafile, "src/main.js")}\n  </head>`));
  const [frame, script] = await Promise.all(["tracker.html", "tracker.js"].map((name) => readFile(`src/${name}`, "utf8")));
  await writeFile(`${folder}/tracker.html`, frame.replace('<script src="tracker.js"></script>', () => `<script>\n${script}</script>`));
  await compress(folder);
});

const names = ["index", "core", "three", "react", "worker", "folds", "local", "local_worker"];
const entries = names.map((name) => `lib/src/${name}.js`);
const external = ["three", "three/*", "react"];
await replace("lib/dist", async (folder) => {
  await build({ ...common, define, external, splitting: true, minifySyntax: true, entryPoints: entries, outdir: folder });
  for (const name of await readdir("lib/types")) await copyFile(`lib/types/${name}`, `${folder}/${name}`);
});
await replace("static/dist", async (folder) => {
  const alone = { ...define, ENGINE_TEXT: '""', WORKER_TEXT: '""' }; // the engine lies in the folder, and the worker is another
  await build({ ...common, define: alone, minify: true, entryPoints: ["static/page.js"], outdir: folder });
  await writeFile(`${folder}/page.js.gz`, gzipSync(await readFile(`${folder}/page.js`), { level: 9 }));
  await rm(`${folder}/page.js`);
  await copyFile("static/index.html", `${folder}/index.html`);
});

const size = gzipSync(await textOf("lib/src/index.js", { define, external: [...external, ...later] })).length;
const kilobytes = (bytes) => (bytes / 1000).toFixed(1);
console.log(`@drape/client: ${kilobytes(size)} kB gzipped, without three.js; the engine, when folds are asked for: ${kilobytes(engine.length)} kB`);
if (size > CORE_LIMIT) throw new Error(`@drape/client: expected ${CORE_LIMIT} bytes at most, got ${size}.`);
if (engine.length > ENGINE_LIMIT) throw new Error(`engine: expected ${ENGINE_LIMIT} bytes at most, got ${engine.length}.`);
