// A waiting or running job.

import { isAbort } from "../api/problem";
import type { Service } from "../api/service";
import type { CurvePoint, Job } from "../api/types";
import { Chart, type Point } from "../parts/chart";
import { h, setText } from "../parts/dom";
import { bytes, count, percent } from "../parts/format";
import { activity, PREVIEWS, remaining } from "../parts/words";

export class LivePanel {
  readonly element: HTMLElement;
  private readonly step = h("p", { class: "headline" });
  private readonly left = h("span", { class: "note" });
  private readonly bar = h("progress", { max: 1, "aria-label": "Progress" });
  private readonly figures = h("dl", { class: "figures" });
  private readonly loss = new Chart({ name: "Loss", unit: "", digits: 4, better: "lower" });
  private readonly psnr = new Chart({ name: "PSNR on held-out photographs", unit: "dB", digits: 1, better: "higher" });
  private readonly charts = h("div", { class: "pair" }, this.loss.element, this.psnr.element);
  private readonly gallery: PreviewGallery;
  private shown: Job;
  private since = performance.now();
  // The time left counts down even if the service sends nothing new.
  private readonly clock = window.setInterval(() => this.showLeft(), 1000);

  constructor(service: Service, job: Job) {
    this.shown = job;
    this.gallery = new PreviewGallery(service, job.id);
    this.element = h(
      "div",
      { class: "live" },
      h("section", { class: "card", "aria-label": "Progress" }, h("div", { class: "stepline" }, this.step, this.left), this.bar, this.figures),
      this.gallery.element,
      this.charts,
    );
  }

  leave(): void {
    clearInterval(this.clock);
    this.gallery.leave();
  }

  update(job: Job): void {
    this.shown = job;
    this.since = performance.now();
    setText(this.step, activity(job));
    this.showLeft();
    if (job.status === "queued" || job.cancelling) this.bar.removeAttribute("value");
    else this.bar.value = job.progress;
    this.showFigures(job);
    this.charts.hidden = job.curve.length === 0;
    this.loss.update(points(job.curve, "loss"));
    this.psnr.update(points(job.curve, "psnr"));
    this.gallery.update(job);
  }

  private showLeft(): void {
    const { shown } = this;
    const left = remaining(shown, (performance.now() - this.since) / 1000);
    setText(this.left, shown.status === "queued" ? "" : [percent(shown.progress), left].filter(Boolean).join(" · "));
  }

  private showFigures(job: Job): void {
    const splats = Object.values(job.splats).reduce((sum, value) => sum + value, 0);
    const rows: [string, string | null][] = [
      ["Iteration", job.iteration === null ? null : `${count(job.iteration)} of ${count(job.total ?? 0)}`],
      ["Splats", splats > 0 ? count(splats) : null],
      ["PSNR", job.psnr === null ? null : `${job.psnr.toFixed(1)} dB`],
      ["Memory", job.memory_bytes === null ? null : bytes(job.memory_bytes)],
    ];
    const shown = rows.filter(([, value]) => value !== null);
    this.figures.hidden = shown.length === 0;
    this.figures.replaceChildren(...shown.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))));
  }
}

function points(curve: CurvePoint[], name: "loss" | "psnr"): Point[] {
  return curve.filter((row) => row[name] !== null).map((row) => ({ x: row.seconds, y: row[name]! }));
}

// The worker uploads a picture shortly after it has announced it.
const FIRST_LOOK = 1200;
const NEXT_LOOK = 2000;
const LOOKS = 5;

class PreviewGallery {
  readonly element = h("section", { class: "previews", "aria-label": "Pictures while training", hidden: true });
  private readonly tiles = new Map<string, PreviewTile>();

  constructor(
    private readonly service: Service,
    private readonly job: string,
  ) {}

  leave(): void {
    for (const tile of this.tiles.values()) tile.leave();
  }

  update(job: Job): void {
    for (const [name, iteration] of Object.entries(job.previews)) {
      let tile = this.tiles.get(name);
      if (tile === undefined) {
        tile = new PreviewTile(this.service, this.job, name);
        this.tiles.set(name, tile);
        this.element.append(tile.element);
      }
      tile.update(job.stage, iteration);
    }
    this.element.hidden = this.tiles.size === 0;
  }
}

class PreviewTile {
  readonly element: HTMLElement;
  private readonly picture: HTMLImageElement;
  private shown = "";
  private version = "";
  private timer = 0;

  constructor(
    private readonly service: Service,
    private readonly job: string,
    private readonly name: string,
  ) {
    const title = PREVIEWS[name] ?? name;
    this.picture = h("img", { alt: `${title} of a held-out view, so far`, hidden: true });
    this.element = h("figure", {}, h("div", { class: "tile" }, this.picture), h("figcaption", {}, title));
  }

  leave(): void {
    clearTimeout(this.timer);
    URL.revokeObjectURL(this.picture.src);
  }

  /** Show the picture of an iteration of a stage. */
  update(stage: string | null, iteration: number): void {
    const wanted = `${stage} ${iteration}`;
    if (wanted === this.shown) return;
    this.shown = wanted;
    this.look(this.version === "" ? 0 : FIRST_LOOK, LOOKS);
  }

  private look(pause: number, tries: number): void {
    clearTimeout(this.timer);
    this.timer = window.setTimeout(async () => {
      if (!(await this.load()) && tries > 1) this.look(NEXT_LOOK, tries - 1);
    }, pause);
  }

  /** Load the picture, and return whether it is new. */
  private async load(): Promise<boolean> {
    try {
      const found = await this.service.preview(this.job, this.name, this.version);
      if (found === null) return false;
      URL.revokeObjectURL(this.picture.src);
      this.picture.src = URL.createObjectURL(found.picture);
      this.picture.hidden = false;
      this.version = found.version;
      return true;
    } catch (error) {
      return isAbort(error);
    }
  }
}
