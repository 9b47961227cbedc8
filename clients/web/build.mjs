// Bundles the page into dist: one script, one style sheet, one document.
import { build } from "esbuild";
import { copyFile, mkdir, rename, rm } from "node:fs/promises";

const staged = "dist.part";
await rm(staged, { recursive: true, force: true });
await mkdir(staged);
await build({
  entryPoints: ["src/main.js"],
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  outfile: `${staged}/main.js`,
  legalComments: "linked",
  logLevel: "warning",
});
for (const name of ["index.html", "style.css", "icon.svg"]) await copyFile(`src/${name}`, `${staged}/${name}`);
await rm("dist", { recursive: true, force: true });
await rename(staged, "dist");
