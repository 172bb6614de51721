// The results of a job.

import type { Service } from "../api/service";
import type { Artifact, Job } from "../api/types";
import { h } from "../parts/dom";
import { count, duration } from "../parts/format";
import { errorBox } from "../parts/notice";
import { downloadSection } from "./downloads";
import { LightSplit } from "./light";
import { logSection } from "./log";
import { reportButton } from "./report";
import { SurfaceSection } from "./surface";

export class ResultsPanel {
  readonly element = h("div", { class: "results" });
  private surface: SurfaceSection | null = null;
  private light: LightSplit | null = null;

  constructor(service: Service, job: Job) {
    void this.fill(service, job);
  }

  leave(): void {
    this.surface?.leave();
    this.light?.leave();
  }

  private async fill(service: Service, job: Job): Promise<void> {
    try {
      const artifacts = await service.artifacts(job.id);
      this.show(service, job, artifacts);
    } catch (error) {
      const again = h("button", { type: "button", onclick: () => void this.fill(service, job) }, "Try again");
      this.element.replaceChildren(errorBox(error, again));
    }
  }

  private show(service: Service, job: Job, artifacts: Artifact[]): void {
    const report = artifacts.find(({ name }) => name === "report.html");
    this.surface = new SurfaceSection(service, job, artifacts);
    this.light = LightSplit.of(service, job, artifacts);
    this.element.replaceChildren(
      figures(job),
      this.surface.element,
      ...(this.light === null ? [] : [this.light.element]),
      h(
        "section",
        { "aria-labelledby": "report-title" },
        h("h2", { id: "report-title" }, "Report"),
        h("p", {}, "The report shows every test view beside its photograph, the scores, the decisions and the settings."),
        report !== undefined && reportButton(service, job, report),
      ),
      downloadSection(service, job, artifacts),
      logSection(service, job.id),
    );
  }
}

function figures(job: Job): HTMLElement {
  const { psnr_test: psnr, ssim_test: ssim, mesh, seconds } = job.metrics;
  const splats = Object.values(job.metrics.gaussians ?? {}).reduce((sum, value) => sum + value, 0);
  const rows: [string, string | null][] = [
    ["PSNR, held-out", psnr === undefined ? null : `${psnr.toFixed(1)} dB`],
    ["SSIM, held-out", ssim === undefined ? null : ssim.toFixed(3)],
    ["Triangles", mesh?.faces === undefined ? null : count(mesh.faces)],
    ["Splats", splats > 0 ? count(splats) : null],
    ["Time", spent(seconds)],
  ];
  const shown = rows.filter(([, value]) => value !== null);
  return h("dl", { class: "figures card" }, ...shown.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))));
}

function spent(seconds: number | Record<string, number> | undefined): string | null {
  if (seconds === undefined) return null;
  if (typeof seconds === "number") return duration(seconds);
  return seconds["total"] === undefined ? null : duration(seconds["total"]);
}
