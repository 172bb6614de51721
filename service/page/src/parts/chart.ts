// A curve over training time, as SVG.

import { h, setText, svg } from "./dom";
import { duration } from "./format";

export interface Point {
  x: number;
  y: number;
}

/** name, unit: of the values. digits: after the decimal point. better: whether lower or higher values are better. */
export interface ChartKind {
  name: string;
  unit: string;
  digits: number;
  better: "higher" | "lower";
}

const HEIGHT = 168;
const MARGIN = { left: 44, right: 12, top: 10, bottom: 24 };
const TICKS = 4;

export class Chart {
  readonly element: HTMLElement;
  private readonly value = h("span", { class: "value" });
  private readonly picture = svg("svg", { role: "img", height: HEIGHT, width: "100%" });
  private points: Point[] = [];

  constructor(private readonly kind: ChartKind) {
    const note = kind.better === "lower" ? "lower is better" : "higher is better";
    this.element = h(
      "figure",
      { class: "chart" },
      h("figcaption", {}, kind.name, h("span", { class: "note" }, note), this.value),
    );
    this.element.append(this.picture);
    new ResizeObserver(() => this.draw()).observe(this.element);
  }

  /** Show points, ordered by x, which is in seconds. */
  update(points: Point[]): void {
    this.points = points;
    this.draw();
  }

  private draw(): void {
    const width = this.element.clientWidth;
    if (width === 0) return;
    const last = this.points.at(-1);
    setText(this.value, last === undefined ? "" : this.say(last.y));
    this.picture.setAttribute("viewBox", `0 0 ${width} ${HEIGHT}`);
    this.picture.setAttribute("aria-label", this.summary());
    if (this.points.length === 0) this.picture.replaceChildren(this.label(width / 2, HEIGHT / 2, "No values yet", "middle"));
    else this.picture.replaceChildren(...this.drawing(width));
  }

  private drawing(width: number): SVGElement[] {
    const end = Math.max(this.points.at(-1)!.x, 1);
    const ticks = roundTicks(Math.min(...this.points.map((p) => p.y)), Math.max(...this.points.map((p) => p.y)));
    const [low, high] = [ticks[0]!, ticks.at(-1)!];
    const x = (value: number) => MARGIN.left + (value / end) * (width - MARGIN.left - MARGIN.right);
    const y = (value: number) => HEIGHT - MARGIN.bottom - ((value - low) / (high - low)) * (HEIGHT - MARGIN.top - MARGIN.bottom);
    const path = this.points.map((p, i) => `${i === 0 ? "M" : "L"}${x(p.x).toFixed(1)} ${y(p.y).toFixed(1)}`).join("");
    const last = this.points.at(-1)!;
    return [
      ...ticks.map((tick) => svg("line", { class: "grid", x1: MARGIN.left, x2: width - MARGIN.right, y1: y(tick), y2: y(tick) })),
      ...ticks.map((tick) => this.label(MARGIN.left - 8, y(tick) + 4, tick.toFixed(decimals(ticks)), "end")),
      this.label(MARGIN.left, HEIGHT - 6, "0 s", "start"),
      this.label(width - MARGIN.right, HEIGHT - 6, duration(end), "end"),
      svg("path", { class: "curve", d: path }),
      svg("circle", { class: "tip", cx: x(last.x), cy: y(last.y), r: 3.5 }),
    ];
  }

  private label(x: number, y: number, text: string, anchor: string): SVGElement {
    return svg("text", { x, y, "text-anchor": anchor }, text);
  }

  private say(value: number): string {
    return `${value.toFixed(this.kind.digits)} ${this.kind.unit}`.trim();
  }

  private summary(): string {
    const [first, last] = [this.points[0], this.points.at(-1)];
    if (first === undefined || last === undefined) return `${this.kind.name}: no values yet`;
    return `${this.kind.name}: from ${this.say(first.y)} to ${this.say(last.y)} in ${duration(last.x)}`;
  }
}

/** Return evenly spaced round values that enclose both limits. */
function roundTicks(low: number, high: number): number[] {
  const span = high - low || Math.abs(high) || 1;
  const power = 10 ** Math.floor(Math.log10(span / TICKS));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => span / size <= TICKS)!;
  const first = Math.floor(low / step);
  const count = Math.max(Math.ceil(high / step), first + 1) - first;
  return Array.from({ length: count + 1 }, (_, i) => (first + i) * step);
}

function decimals(ticks: number[]): number {
  return Math.max(0, -Math.floor(Math.log10(ticks[1]! - ticks[0]!) + 1e-9));
}
