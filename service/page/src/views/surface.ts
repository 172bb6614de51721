// The mesh and the splats in 3D. The viewer is large, so it is loaded on request.

import type { Service } from "../api/service";
import type { Artifact, Job } from "../api/types";
import { h, setText } from "../parts/dom";
import { bytes, percent } from "../parts/format";
import { announce, errorBox } from "../parts/notice";
import { onPress } from "../parts/press";
import type { Viewer } from "../viewer/viewer";

const SPLATS = ["splats_3d.ply", "splats_2d.ply"];

export class SurfaceSection {
  readonly element: HTMLElement;
  private readonly stage = h("div", { class: "stage tile" });
  private viewer: Viewer | null = null;
  private left = false;

  constructor(
    private readonly service: Service,
    private readonly job: Job,
    private readonly artifacts: Artifact[],
  ) {
    this.element = h(
      "section",
      { class: "surface", "aria-labelledby": "surface-title" },
      h("h2", { id: "surface-title" }, "The surface"),
      this.stage,
    );
    this.invite();
  }

  leave(): void {
    this.left = true;
    this.viewer?.leave();
  }

  /** Show a picture, and a button that loads the viewer. */
  private invite(): void {
    const mesh = this.find("model.glb");
    const splats = this.find(...SPLATS);
    if (mesh === undefined) return this.stage.replaceChildren(h("p", { class: "note" }, "The job has no model."));
    const state = h("span", {}, "Show in 3D");
    const environment = this.find("environment.exr");
    const size = h("span", { class: "note" }, bytes(mesh.size + (splats?.size ?? 0) + (environment?.size ?? 0)));
    const button = h("button", { type: "button", class: "main" }, state);
    const progress = (share: number) => setText(state, share < 1 ? `Loading ${percent(share)}` : "Preparing");
    onPress(button, () => this.open([mesh, splats, environment], progress));
    this.stage.replaceChildren(h("div", { class: "invite" }, button, size));
    void this.addPoster();
  }

  private async addPoster(): Promise<void> {
    const poster = this.artifacts.find(({ name }) => /^renders\/.*_normal\.png$/.test(name));
    if (poster === undefined) return;
    const picture = await this.service.file(this.job.id, poster).catch(() => null);
    if (picture === null || this.viewer !== null || this.left) return;
    const image = h("img", { class: "poster", alt: "", src: URL.createObjectURL(picture) });
    image.addEventListener("load", () => URL.revokeObjectURL(image.src));
    this.stage.prepend(image);
  }

  /** Load model, splats and environment, and show them. */
  private async open(wanted: (Artifact | undefined)[], progress: (share: number) => void): Promise<void> {
    const whole = wanted.reduce((sum, artifact) => sum + (artifact?.size ?? 0), 0);
    const received = wanted.map(() => 0);
    const load = async (artifact: Artifact | undefined, i: number): Promise<ArrayBuffer | null> => {
      if (artifact === undefined) return null;
      const file = await this.service.file(this.job.id, artifact, (share) => {
        received[i] = share * artifact.size;
        progress(received.reduce((sum, value) => sum + value, 0) / whole);
      });
      return file.arrayBuffer();
    };
    try {
      const [module, mesh, splats, environment] = await Promise.all([import("../viewer/viewer"), ...wanted.map(load)]);
      const viewer = await module.openViewer({ mesh: mesh!, splats: splats ?? null, environment: environment ?? null });
      if (this.left) return viewer.leave();
      this.viewer = viewer;
      this.stage.replaceWith(viewer.element);
      viewer.focus();
      announce("The page shows the surface in 3D. Arrow keys turn it; plus and minus zoom.");
    } catch (error) {
      this.invite();
      this.stage.append(errorBox(error));
    }
  }

  private find(...names: string[]): Artifact | undefined {
    return names.map((name) => this.artifacts.find((one) => one.name === name)).find((one) => one !== undefined);
  }
}
