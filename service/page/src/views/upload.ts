// The current upload. It belongs to the whole page, so it continues while the user looks at other jobs.

import { isAbort } from "../api/problem";
import type { Service } from "../api/service";
import type { Job, JobOptions } from "../api/types";
import { Upload } from "../api/upload";
import type { Capture } from "../archive/capture";
import { h, setText } from "../parts/dom";
import { bytes, duration, percent } from "../parts/format";
import { announce, errorBox } from "../parts/notice";

export class UploadTray {
  private running: AbortController | null = null;

  /** place: the element that shows the upload. arrived: called with the new job. */
  constructor(
    private readonly service: Service,
    private readonly place: HTMLElement,
    private readonly arrived: (job: Job) => void,
  ) {
    addEventListener("beforeunload", (event) => {
      if (this.running !== null) event.preventDefault();
    });
  }

  /** Return whether an upload is in progress. */
  get busy(): boolean {
    return this.running !== null;
  }

  /** Send a capture. Errors are shown with a button that continues. */
  async start(capture: Capture, options: JobOptions): Promise<void> {
    await this.send(capture, new Upload(this.service, capture, options));
  }

  private async send(capture: Capture, upload: Upload): Promise<void> {
    const stop = new AbortController();
    this.running = stop;
    const progress = this.show(capture, stop);
    announce(`Sending ${capture.name}`);
    try {
      const job = await upload.send(progress, stop.signal);
      this.done();
      announce(`${capture.name} has arrived`);
      this.arrived(job);
    } catch (error) {
      this.done();
      if (!isAbort(error)) this.fail(error, () => void this.send(capture, upload));
      else announce("The upload was cancelled");
    }
  }

  private show(capture: Capture, stop: AbortController): (sent: number) => void {
    const bar = h("progress", { max: 1, value: 0, "aria-label": "Upload" });
    const words = h("span", { class: "note" });
    const startedAt = performance.now();
    let first: number | null = null; // the share that was sent before a reload of the page
    this.place.replaceChildren(
      h(
        "div",
        { class: "card tray", tabindex: -1 },
        h("p", {}, h("strong", {}, `Sending ${capture.name}`), words),
        bar,
        h("button", { type: "button", onclick: () => stop.abort() }, "Cancel upload"),
      ),
    );
    // The focused button is gone. The focus must not go to the new button, because a second Enter would cancel.
    this.place.querySelector<HTMLElement>(".tray")!.focus();
    return (sent) => {
      const share = Math.min(sent / capture.archive.size, 1);
      first ??= share;
      const left = ((performance.now() - startedAt) / 1000 / (share - first)) * (1 - share);
      bar.value = share;
      const rest = share >= 1 ? "the service checks the upload" : share - first > 0.02 ? `${duration(left)} left` : "";
      setText(words, [`${percent(share)} of ${bytes(capture.archive.size)}`, rest].filter(Boolean).join(" · "));
    };
  }

  private fail(error: unknown, again: () => void): void {
    const retry = h("button", { type: "button", class: "main", onclick: again }, "Send again");
    const close = h("button", { type: "button", onclick: () => this.done() }, "Dismiss");
    this.place.replaceChildren(errorBox(error, retry, close));
  }

  private done(): void {
    this.running = null;
    this.place.replaceChildren();
  }
}
