// The light split of a view: the object's own colour, the reflections, and their sum. If the photographs were taken with
// a flash, also the own colour under even light.

import type { Service } from "../api/service";
import type { Artifact, Job } from "../api/types";
import { h, newId, setText } from "../parts/dom";
import { errorBox } from "../parts/notice";

const PARTS = ["", "_transmitted", "_reflected", "_weight"];
const EVEN = "_even";
const EVEN_STOP = { at: -200, name: "Even light", note: "The object's own colour under even light, without the flash's shading and shadows." };
const STOPS = [
  { at: -100, name: "Own colour", note: "The object's own colour: transmitted light without gloss." },
  { at: 0, name: "Full", note: "The full render: the sum of own colour and reflections." },
  { at: 100, name: "Reflections", note: "Light from gloss and lamps, times a learned weight." },
];

/** Shows one view at a time. A slider fades from own colour, under even light first, over the sum to reflections. */
export class LightSplit {
  readonly element: HTMLElement;
  private readonly canvas = h("canvas", { role: "img" });
  private readonly stops: typeof STOPS;
  private readonly slider: HTMLInputElement;
  private readonly note = h("p", { class: "note", "aria-live": "polite" });
  private readonly trouble = h("div");
  private layers: Layers | null = null;
  private left = false;

  /** Return the section, or null if the job's light was not split. */
  static of(service: Service, job: Job, artifacts: Artifact[]): LightSplit | null {
    const held = new Map(artifacts.map((artifact) => [artifact.name, artifact]));
    const views = artifacts
      .filter(({ name }) => name.endsWith("_reflected.png"))
      .map(({ name }) => name.slice(0, -"_reflected.png".length))
      .filter((view) => PARTS.every((part) => held.has(`${view}${part}.png`)));
    return views.length === 0 ? null : new LightSplit(service, job, held, views);
  }

  private constructor(
    private readonly service: Service,
    private readonly job: Job,
    private readonly held: Map<string, Artifact>,
    views: string[],
  ) {
    const id = newId();
    this.stops = views.every((view) => held.has(`${view}${EVEN}.png`)) ? [EVEN_STOP, ...STOPS] : STOPS;
    this.slider = h("input", { type: "range", id, min: this.stops[0]!.at, max: 100, step: 5, value: 0 });
    this.slider.addEventListener("input", () => this.draw());
    const stops = this.stops.map(({ at, name }) => h("button", { type: "button", class: "quiet", onclick: () => this.go(at) }, name));
    this.element = h(
      "section",
      { class: "light", "aria-labelledby": "light-title" },
      h("h2", { id: "light-title" }, "The light split"),
      this.trouble,
      h(
        "div",
        { class: "split" },
        h("div", { class: "tile" }, this.canvas),
        h(
          "div",
          {},
          h("p", {}, "Each render is the sum of two lights. The mesh takes its colours from the first alone, so they contain no highlights."),
          h("label", { for: id }, "From own colour to reflections"),
          this.slider,
          h("div", { class: "stops" }, ...stops),
          this.note,
          this.viewChoice(views),
        ),
      ),
    );
    void this.load(views[0]!);
  }

  leave(): void {
    this.left = true;
  }

  private viewChoice(views: string[]): HTMLElement | null {
    if (views.length < 2) return null;
    const id = newId();
    const options = views.map((view) => h("option", { value: view }, view.replace(/^renders\/(test\/)?/, "")));
    const choice = h("select", { id }, ...options);
    choice.addEventListener("change", () => void this.load(choice.value));
    return h("div", { class: "field" }, h("label", { for: id }, "Held-out view"), choice);
  }

  private go(at: number): void {
    this.slider.value = `${at}`;
    this.draw();
  }

  private async load(view: string): Promise<void> {
    try {
      const parts = this.stops.includes(EVEN_STOP) ? [...PARTS, EVEN] : PARTS;
      const [full, transmitted, reflected, weight, even] = await Promise.all(parts.map((part) => this.picture(`${view}${part}.png`)));
      if (this.left) return;
      this.layers = { full: full!, transmitted: transmitted!, reflected: weighted(reflected!, weight!), even: even ?? null };
      this.canvas.width = full!.width;
      this.canvas.height = full!.height;
      this.draw();
    } catch (error) {
      this.trouble.replaceChildren(errorBox(error));
    }
  }

  private async picture(name: string): Promise<ImageBitmap> {
    return createImageBitmap(await this.service.file(this.job.id, this.held.get(name)!));
  }

  private draw(): void {
    const at = this.slider.valueAsNumber;
    const stop = this.stops.reduce((best, one) => (Math.abs(one.at - at) <= Math.abs(best.at - at) ? one : best));
    this.slider.setAttribute("aria-valuetext", stop.at === at ? stop.name : between(at));
    this.canvas.setAttribute("aria-label", `A held-out view: ${stop.name.toLowerCase()}`);
    setText(this.note, stop.note);
    if (this.layers !== null) paint(this.canvas.getContext("2d")!, this.layers, at / 100);
  }
}

/** Describe the picture between two stops in words. */
function between(at: number): string {
  if (at < -100) return `Own colour, even light at ${-100 - at} %`;
  return `Own colour and reflections, ${at < 0 ? `reflections at ${100 + at} %` : `own colour at ${100 - at} %`}`;
}

/** Pictures of a view, in the same size. reflected: weighted reflected light, to be added. even: null without a flash. */
interface Layers {
  even: ImageBitmap | null;
  full: ImageBitmap;
  transmitted: ImageBitmap;
  reflected: HTMLCanvasElement;
}

/** Draw a blend: own colour under even light at -2, own colour at -1, the sum at 0, and the reflections at 1. */
function paint(context: CanvasRenderingContext2D, layers: Layers, at: number): void {
  const { width, height } = context.canvas;
  context.globalCompositeOperation = "source-over";
  context.globalAlpha = 1;
  context.clearRect(0, 0, width, height);
  if (at === 0) {
    context.drawImage(layers.full, 0, 0); // as rendered, not rounded twice
    return;
  }
  context.globalAlpha = Math.min(1, 1 - at);
  context.drawImage(layers.transmitted, 0, 0);
  if (at < -1 && layers.even !== null) {
    // Removing a share of one picture and adding the same share of the other keeps the opacity of edges.
    context.globalCompositeOperation = "destination-out";
    context.globalAlpha = -1 - at;
    context.fillRect(0, 0, width, height);
    context.globalCompositeOperation = "lighter";
    context.drawImage(layers.even, 0, 0);
    return;
  }
  context.globalCompositeOperation = "lighter";
  context.globalAlpha = Math.min(1, 1 + at);
  context.drawImage(layers.reflected, 0, 0);
  // Reflected light alone is visible only on black, so the tile behind it fades with the own colour.
  context.globalCompositeOperation = "destination-over";
  context.globalAlpha = Math.max(0, at);
  context.fillRect(0, 0, width, height);
}

/** Return the weighted reflected light, as opaque as it is bright, so that the tile shows through elsewhere. */
function weighted(reflected: ImageBitmap, weight: ImageBitmap): HTMLCanvasElement {
  const canvas = h("canvas", { width: reflected.width, height: reflected.height });
  const context = canvas.getContext("2d", { willReadFrequently: true })!;
  const weights = pixels(context, weight);
  const light = pixels(context, reflected);
  for (let i = 0; i < light.data.length; i += 4) {
    const [red, green, blue] = [light.data[i]!, light.data[i + 1]!, light.data[i + 2]!];
    const brightest = Math.max(red, green, blue, 1);
    light.data[i] = (red * 255) / brightest;
    light.data[i + 1] = (green * 255) / brightest;
    light.data[i + 2] = (blue * 255) / brightest;
    light.data[i + 3] = (brightest * weights.data[i]!) / 255;
  }
  context.putImageData(light, 0, 0);
  return canvas;
}

function pixels(context: CanvasRenderingContext2D, picture: ImageBitmap): ImageData {
  context.clearRect(0, 0, picture.width, picture.height);
  context.drawImage(picture, 0, 0);
  return context.getImageData(0, 0, picture.width, picture.height);
}
