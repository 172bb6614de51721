// Bundles src/ into built/, which is committed so that installing MGSR needs no Node. `--check` compares without writing.
import { mkdir, readFile, readdir, rm, writeFile } from "node:fs/promises";
import { dirname, join, relative } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const source = join(here, "src");
const target = join(here, "built");

// Packages whose code is in the bundle. fflate is part of Spark's and three's own files.
const NOTICES = [
  "three",
  "@sparkjsdev/spark",
  "fflate",
  "tus-js-client",
  "js-base64",
  "querystringify",
  "requires-port",
  "url-parse",
];

async function bundle() {
  const result = await build({
    absWorkingDir: here,
    entryPoints: ["src/main.ts", "src/style/page.css"],
    bundle: true,
    splitting: true,
    minify: true,
    format: "esm",
    target: "es2022",
    // Names contain a hash of the content, so browsers may cache each file for ever.
    entryNames: "[name]-[hash]",
    chunkNames: "[name]-[hash]",
    outdir: "built",
    // NOTICES.txt contains the full text of every licence.
    legalComments: "none",
    charset: "utf8",
    metafile: true,
    write: false,
    logLevel: "warning",
  });
  const files = new Map(result.outputFiles.map((file) => [relative(target, file.path), Buffer.from(file.contents)]));
  const names = Object.fromEntries(
    Object.entries(result.metafile.outputs)
      .filter(([, output]) => output.entryPoint)
      .map(([path, output]) => [output.entryPoint, relative("built", path)]),
  );
  checkNotices(result.metafile);
  files.set("index.html", await page(names));
  files.set("report.html", await readFile(join(source, "report.html")));
  files.set("icon.svg", await readFile(join(source, "icon.svg")));
  files.set("NOTICES.txt", await notices());
  return files;
}

async function page(names) {
  const text = await readFile(join(source, "index.html"), "utf8");
  const filled = text
    .replace("page.css", names["src/style/page.css"])
    .replace("main.js", names["src/main.ts"]);
  return Buffer.from(filled);
}

function checkNotices(metafile) {
  const bundled = Object.keys(metafile.inputs).map((path) => /node_modules\/((?:@[^/]+\/)?[^/]+)/.exec(path)?.[1]);
  const missing = [...new Set(bundled)].filter((name) => name !== undefined && !NOTICES.includes(name));
  if (missing.length > 0) throw new Error(`NOTICES lacks ${missing.join(", ")}, whose code is in the bundle`);
}

async function notices() {
  const parts = await Promise.all(
    NOTICES.map(async (name) => {
      const folder = join(here, "node_modules", name);
      const { version, license } = JSON.parse(await readFile(join(folder, "package.json"), "utf8"));
      const file = (await readdir(folder)).find((each) => /^LICENSE(\.md)?$/.test(each));
      const text = await readFile(join(folder, file), "utf8");
      return `${name} ${version} (${license})\n\n${text.replaceAll("\r\n", "\n").trim()}\n`;
    }),
  );
  const head = "The web page of MGSR contains code of these packages.\n";
  return Buffer.from([head, ...parts].join(`\n${"-".repeat(80)}\n\n`));
}

async function write(files) {
  await rm(target, { recursive: true, force: true });
  await mkdir(target, { recursive: true });
  for (const [name, data] of files) {
    await writeFile(join(target, name), data);
    console.log(`${String(data.length).padStart(9)}  ${name}`);
  }
}

async function check(files) {
  const held = new Set(await readdir(target));
  const wrong = [...files.keys()].filter((name) => !held.has(name)).map((name) => `missing: ${name}`);
  for (const name of held) {
    const fresh = files.get(name);
    if (fresh === undefined) wrong.push(`left over: ${name}`);
    else if (!fresh.equals(await readFile(join(target, name)))) wrong.push(`differs: ${name}`);
  }
  if (wrong.length > 0) {
    console.error(`built/ is not what src/ gives; run \`make page\` and commit built/:\n${wrong.join("\n")}`);
    process.exit(1);
  }
  console.log(`built/ is what src/ gives: ${files.size} files`);
}

const files = await bundle();
await (process.argv.includes("--check") ? check(files) : write(files));
