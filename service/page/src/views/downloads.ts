// The result files.

import type { Service } from "../api/service";
import type { Artifact, Job } from "../api/types";
import { h, setText } from "../parts/dom";
import { bytes, percent } from "../parts/format";
import { announce } from "../parts/notice";
import { onPress } from "../parts/press";
import { explain } from "../parts/words";

const ABOUT: Record<string, string> = {
  "model.glb": "Textured model for viewers, games and modelling programs, y up",
  "model_draco.glb": "The same, compressed for the web",
  "model.usdz": "The same for devices by Apple",
  "environment.exr": "The light around the object, to render it in",
  "mesh.obj": "Mesh for older programs",
  "mesh.ply": "Mesh in the frame of your cameras",
  "splats_3d.ply": "Gaussians for splat viewers",
  "splats_2d.ply": "Surfels for splat viewers",
  "report.html": "The report, a single file",
  "report.json": "The figures of the report, for programs",
};

/** Return the section of all files. */
export function downloadSection(service: Service, job: Job, artifacts: Artifact[]): HTMLElement {
  const known = Object.keys(ABOUT);
  const first = artifacts.filter(({ name }) => known.includes(name)).sort((a, b) => known.indexOf(a.name) - known.indexOf(b.name));
  const rest = artifacts.filter(({ name }) => !known.includes(name));
  return h(
    "section",
    { "aria-labelledby": "files-title" },
    h("h2", { id: "files-title" }, "Downloads"),
    listing(service, job, first),
    rest.length > 0 && h("details", {}, h("summary", {}, `All other files (${rest.length})`), listing(service, job, rest)),
  );
}

function listing(service: Service, job: Job, artifacts: Artifact[]): HTMLElement {
  return h("ul", { class: "files" }, ...artifacts.map((artifact) => row(service, job, artifact)));
}

function row(service: Service, job: Job, artifact: Artifact): HTMLElement {
  const state = h("span", {}, "Download");
  const button = h("button", { type: "button", "aria-label": `Download ${artifact.name}` }, state);
  onPress(button, async () => {
    try {
      save(await service.file(job.id, artifact, (share) => setText(state, percent(share))), fileName(job, artifact));
      setText(state, "Download");
      announce(`${artifact.name} is downloaded`);
    } catch (error) {
      setText(state, "Try again");
      announce(explain(error).headline);
    }
  });
  return h(
    "li",
    {},
    h("span", { class: "name" }, artifact.name),
    h("span", { class: "note" }, [ABOUT[artifact.name], bytes(artifact.size)].filter(Boolean).join(" · ")),
    button,
  );
}

/** Return the file name of a download, such as "vase-model.glb" for the model of the job "vase". */
function fileName(job: Job, artifact: Artifact): string {
  const name = (job.name ?? "mgsr").replace(/[^\p{L}\p{N}._-]+/gu, "_");
  return `${name}-${artifact.name.replaceAll("/", "-")}`;
}

function save(file: Blob, name: string): void {
  const link = h("a", { href: URL.createObjectURL(file), download: name });
  link.click();
  // By then the browser has begun to read the file.
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
