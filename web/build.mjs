// Builds the page into geort_drake/live/web/static, with MediaPipe's files and all licences.
import { cpSync, mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = fileURLToPath(new URL(".", import.meta.url));
const out = fileURLToPath(new URL("../geort_drake/live/web/static/", import.meta.url));
const packages = `${here}node_modules`;

rmSync(out, { recursive: true, force: true });
mkdirSync(`${out}hands`, { recursive: true });
const target = ["chrome111", "firefox132", "safari17"];
const common = { bundle: true, minify: true, outdir: out, target, legalComments: "none" };
await build({ ...common, entryPoints: [`${here}src/main.js`, `${here}src/style.css`], format: "esm" });
// MediaPipe loads itself by importScripts, which only classic workers have.
await build({ ...common, entryPoints: [`${here}src/worker.js`], format: "iife" });
cpSync(`${here}src/index.html`, `${out}index.html`);
cpSync(`${here}../docs/assets/favicon.svg`, `${out}icon.svg`);
for (const name of [
  "hands.js",
  "hands.binarypb",
  "hand_landmark_lite.tflite",
  "hands_solution_packed_assets.data",
  "hands_solution_packed_assets_loader.js",
  "hands_solution_simd_wasm_bin.js",
  "hands_solution_simd_wasm_bin.wasm",
])
  cpSync(`${packages}/@mediapipe/hands/${name}`, `${out}hands/${name}`);

const licences = [
  ["three", `${packages}/three/LICENSE`],
  ["@mediapipe/hands", `${here}apache-2.0.txt`],
].map(([name, file]) => {
  const { version, license } = JSON.parse(readFileSync(`${packages}/${name}/package.json`, "utf8"));
  return `${name} ${version}, ${license}\n\n${readFileSync(file, "utf8").trim()}\n`;
});
writeFileSync(`${out}licences.txt`, licences.join(`\n${"-".repeat(80)}\n\n`));
