// The home view: a new reconstruction, and the list of jobs.

import type { Service } from "../api/service";
import type { Options } from "../api/types";
import { captureOf, droppedFiles, pickedFiles, type Capture } from "../archive/capture";
import type { Member } from "../archive/tar";
import { h } from "../parts/dom";
import { bytes, count } from "../parts/format";
import { announce } from "../parts/notice";
import { JobListing } from "./list";
import { OptionsForm } from "./options";
import type { UploadTray } from "./upload";
import type { View } from "./view";

/** Return the home view. options: the service's options. tray: the sender of uploads. */
export function homeView(service: Service, options: Options, tray: UploadTray): View {
  const listing = new JobListing(service);
  const picker = new Picker(options, tray);
  const element = h(
    "div",
    { class: "home" },
    h(
      "div",
      { class: "intro" },
      h("h1", {}, "Surfaces from photographs"),
      h("p", { class: "lead" }, "MGSR turns photographs or a video into a mesh, splats and clean renders."),
    ),
    picker.element,
    listing.element,
  );
  return { title: "MGSR", element, leave: () => listing.leave() };
}

/** The card that takes files, and then shows the options. */
class Picker {
  readonly element: HTMLElement;
  private readonly zone: HTMLElement;
  private readonly problem = h("p", { class: "notice bad", role: "alert", hidden: true });
  private readonly after = h("div");

  constructor(
    private readonly options: Options,
    private readonly tray: UploadTray,
  ) {
    this.zone = this.makeZone();
    this.element = h(
      "section",
      { class: "picker", "aria-labelledby": "new-title" },
      h("h2", { id: "new-title" }, "New reconstruction"),
      this.problem,
      this.zone,
      this.after,
    );
  }

  private makeZone(): HTMLElement {
    const accept = "image/*,video/*,.mkv,.zip,.tar,.tgz,.gz,.tzst,.zst";
    const single = h("input", { type: "file", class: "unseen", accept, multiple: true, tabindex: -1, "aria-hidden": "true" });
    const folder = h("input", { type: "file", class: "unseen", webkitdirectory: true, tabindex: -1, "aria-hidden": "true" });
    for (const input of [single, folder]) {
      input.addEventListener("change", () => {
        this.take(pickedFiles(input.files!));
        input.value = "";
      });
    }
    const zone = h(
      "div",
      { class: "zone" },
      h("p", { class: "headline" }, "Drop photographs, a video, a folder or an archive here"),
      h(
        "div",
        { class: "actions" },
        h("button", { type: "button", onclick: () => single.click() }, "Choose files"),
        h("button", { type: "button", onclick: () => folder.click() }, "Choose a folder"),
      ),
      h(
        "p",
        { class: "note" },
        "Use twenty or more photographs from all around, or a video of a walk around the object. MGSR first finds the cameras, ",
        "unless the capture has them from COLMAP, nerfstudio, Metashape or another program. ",
        `Archives: zip, tar, tar.gz or tar.zst. Videos: mp4, mov or webm. Up to ${bytes(this.options.max_upload)}.`,
      ),
      single,
      folder,
    );
    this.acceptDrops(zone);
    return zone;
  }

  private acceptDrops(zone: HTMLElement): void {
    zone.addEventListener("dragover", (event) => {
      event.preventDefault();
      zone.classList.add("over");
    });
    zone.addEventListener("dragleave", () => zone.classList.remove("over"));
    zone.addEventListener("drop", async (event) => {
      event.preventDefault();
      zone.classList.remove("over");
      this.take(await droppedFiles(event.dataTransfer!.items));
    });
  }

  private take(members: Member[]): void {
    const capture = captureOf(members);
    const refusal = this.refusal(capture);
    this.problem.hidden = refusal === null;
    this.problem.textContent = refusal;
    if (capture !== null && refusal === null) this.ask(capture);
  }

  private refusal(capture: Capture | null): string | null {
    if (this.tray.busy) return "An upload is in progress. Wait until it ends, or cancel it.";
    if (capture === null) return "The folder has no files. Choose photographs, a video, a folder of photographs, or an archive.";
    if (capture.archive.size <= this.options.max_upload) return null;
    const [has, limit] = [bytes(capture.archive.size), bytes(this.options.max_upload)];
    return `This capture has ${has}, but the service accepts at most ${limit}. Use smaller or fewer images.`;
  }

  private ask(capture: Capture): void {
    const form = new OptionsForm(this.options, capture.name);
    const whole = capture.type.startsWith("video/") ? "video" : "archive";
    const files = capture.files === null ? whole : capture.files === 1 ? "1 file" : `${count(capture.files)} files`;
    const close = () => {
      this.after.replaceChildren();
      this.zone.hidden = false;
    };
    form.element.prepend(
      h("p", { class: "picked" }, h("strong", {}, capture.name), h("span", { class: "note" }, `${files}, ${bytes(capture.archive.size)}`)),
    );
    form.element.append(
      h(
        "div",
        { class: "actions" },
        h("button", { type: "submit", class: "main" }, "Start"),
        h("button", { type: "button", onclick: close }, "Choose something else"),
      ),
    );
    form.element.addEventListener("submit", (event) => {
      event.preventDefault();
      const options = form.read();
      close();
      void this.tray.start(capture, options);
    });
    this.zone.hidden = true;
    this.after.replaceChildren(form.element);
    announce(`${capture.name}: ${files}. Choose the options.`);
    form.focus();
  }
}
