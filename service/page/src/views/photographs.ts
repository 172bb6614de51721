// The checked photographs: thumbnails, found masks, and their cameras in 3D.

import type { Service } from "../api/service";
import type { Finding, Job, Photograph, Photographs } from "../api/types";
import { h, newId, setText } from "../parts/dom";
import { announce, errorBox } from "../parts/notice";
import { onPress } from "../parts/press";
import { severityWord } from "../parts/words";
import type { CameraView } from "../viewer/cameras";

type SheetName = "photographs" | "masks";
const SHEETS: Record<SheetName, string> = { photographs: "Photographs", masks: "Masks" };

/** A sheet of small pictures and its address. */
interface Sheet {
  blob: Blob;
  url: string;
}

export class PhotographsSection {
  readonly element: HTMLDetailsElement;
  private readonly title = h("summary", {}, "The photographs and their cameras");
  private readonly inside = h("div", { class: "photographs" });
  private readonly chosen = h("p", { class: "note", role: "status" }, "Choose a photograph to see its camera.");
  private readonly stage = h("div", { class: "cameras" });
  private readonly grid = h("ul", { class: "thumbs" });
  private readonly thumbs: HTMLButtonElement[] = [];
  private readonly sheets = new Map<SheetName, Sheet>();
  private held: Photographs | null = null;
  private findings: Finding[] = [];
  private step: string | null = null;
  private view: CameraView | null = null;
  private selected = -1;
  private left = false;

  constructor(
    private readonly service: Service,
    private readonly job: string,
  ) {
    this.element = h("details", { class: "photos", hidden: true }, this.title, this.inside);
    this.element.addEventListener("toggle", () => {
      if (this.element.open && this.held?.masks !== true) void this.load();
    });
  }

  leave(): void {
    this.left = true;
    this.view?.leave();
    for (const { url } of this.sheets.values()) URL.revokeObjectURL(url);
  }

  /** Update the section. A job has photographs once it is checked; the masks come in a later step. */
  update(job: Job): void {
    this.findings = job.findings ?? [];
    this.element.hidden = job.findings === null;
    const [before, now] = [this.step, job.step];
    this.step = now;
    if (before !== now && this.element.open && this.held?.masks !== true) void this.load();
  }

  private async load(): Promise<void> {
    try {
      const found = await this.service.photographs(this.job);
      await this.loadSheet("photographs");
      if (found.masks) await this.loadSheet("masks");
      if (this.left) return;
      const first = this.held === null;
      this.held = found;
      if (first) this.build(found);
      else if (found.masks) this.offerMasks();
    } catch (error) {
      if (this.held === null) this.inside.replaceChildren(errorBox(error));
    }
  }

  private async loadSheet(name: SheetName): Promise<void> {
    if (this.sheets.has(name)) return;
    const blob = await this.service.sheet(this.job, name);
    this.sheets.set(name, { blob, url: URL.createObjectURL(blob) });
  }

  private build(found: Photographs): void {
    setText(this.title, `The ${found.photographs.length} photographs and their cameras`);
    found.photographs.forEach((photo, index) => this.grid.append(this.thumb(photo, index)));
    const button = h("button", { type: "button" }, "Show the cameras in 3D");
    onPress(button, () => this.open(found));
    this.stage.replaceChildren(button);
    this.inside.replaceChildren(this.stage, this.grid, this.chosen);
    this.paint("photographs");
    if (found.masks) this.offerMasks();
  }

  private thumb(photo: Photograph, index: number): HTMLElement {
    const severity = this.severity(photo.name);
    const label = severity === null ? photo.name : `${photo.name}: ${severityWord(severity).toLowerCase()}`;
    const attributes = { type: "button", class: "thumb", "aria-label": label, "aria-pressed": "false", title: label };
    const button = h("button", { ...attributes, "data-severity": severity });
    button.addEventListener("click", () => this.select(index));
    this.thumbs.push(button);
    return h("li", {}, button);
  }

  /** Return the severity of the worst finding that names a photograph. */
  private severity(name: string): Finding["severity"] | null {
    return this.findings.find(({ photographs }) => photographs.includes(name))?.severity ?? null;
  }

  /** A choice between photographs and masks, once there are masks. */
  private offerMasks(): void {
    if (this.inside.querySelector("fieldset") !== null) return;
    const name = newId();
    const choice = (sheet: SheetName) => {
      const change = () => this.paint(sheet);
      const input = h("input", { type: "radio", name, checked: sheet === "photographs", onchange: change });
      return h("label", {}, input, h("span", {}, SHEETS[sheet]));
    };
    const choices = h("fieldset", { class: "segmented" }, h("legend", {}, "Pictures"), choice("photographs"), choice("masks"));
    this.grid.before(choices);
  }

  /** Show the pictures of a sheet in thumbnails and cameras. */
  private paint(name: SheetName): void {
    const sheet = this.sheets.get(name);
    if (sheet === undefined || this.held === null) return;
    const { columns } = this.held;
    this.grid.dataset["sheet"] = name;
    const rows = Math.ceil(this.thumbs.length / columns);
    this.thumbs.forEach(({ style }, index) => {
      const [column, row] = [index % columns, Math.floor(index / columns)];
      style.backgroundImage = `url("${sheet.url}")`;
      style.backgroundSize = `${columns * 100}% ${rows * 100}%`;
      style.backgroundPosition = `${share(column, columns)}% ${share(row, rows)}%`;
    });
    void this.view?.paint(sheet.blob);
  }

  private async open(found: Photographs): Promise<void> {
    try {
      const { openCameras } = await import("../viewer/cameras");
      const severities = found.photographs.map(({ name }) => this.severity(name));
      const missing = this.findings.flatMap(({ places }) => places);
      const view = openCameras(found, severities, missing, (index) => this.select(index));
      if (this.left) return view.leave();
      this.view = view;
      this.stage.replaceChildren(view.element);
      const shown = (this.grid.dataset["sheet"] ?? "photographs") as SheetName;
      await view.paint(this.sheets.get(shown)!.blob);
      if (this.selected >= 0) view.select(this.selected);
      announce("The page shows the cameras in 3D. Arrow keys turn the view; plus and minus zoom.");
    } catch (error) {
      this.stage.append(errorBox(error));
    }
  }

  private select(index: number): void {
    this.thumbs[this.selected]?.setAttribute("aria-pressed", "false");
    this.selected = index;
    const thumb = this.thumbs[index]!;
    thumb.setAttribute("aria-pressed", "true");
    thumb.scrollIntoView({ block: "nearest" });
    this.view?.select(index);
    setText(this.chosen, this.words(this.held!.photographs[index]!));
  }

  private words({ name, residual, reprojection }: Photograph): string {
    const told = this.findings.filter(({ photographs }) => photographs.includes(name)).map(({ text }) => text);
    const fit = [
      residual !== null && `its matches lie ${residual} px from the epipolar lines`,
      reprojection !== null && `shared points project ${reprojection} px beside their places`,
    ].filter(Boolean);
    const known = fit.length > 0 ? fit.join("; ") : "too few of its features match others to check its camera";
    return [`${name}: ${known}.`, ...told.map((text) => `${text.charAt(0).toUpperCase()}${text.slice(1)}.`)].join(" ");
  }
}

/** Return the background position, in percent, that shows one of a number of parts. */
function share(part: number, parts: number): number {
  return parts > 1 ? (100 * part) / (parts - 1) : 0;
}
