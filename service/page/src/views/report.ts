// The report, in a frame of its own (see report.html).

import type { Service } from "../api/service";
import type { Artifact, Job } from "../api/types";
import { openDialog } from "../parts/dialog";
import { h } from "../parts/dom";
import { errorBox } from "../parts/notice";
import { pressButton } from "../parts/press";

/** Return a button that opens the report. */
export function reportButton(service: Service, job: Job, artifact: Artifact): HTMLElement {
  const place = h("div");
  const button = pressButton("Open the report", "", async () => {
    place.replaceChildren();
    try {
      show(await (await service.file(job.id, artifact)).text());
    } catch (error) {
      place.replaceChildren(errorBox(error));
    }
  });
  return h("div", {}, button, place);
}

function show(report: string): void {
  const frame = h("iframe", { src: "/page/report.html", sandbox: "allow-scripts", title: "Report" });
  const ready = (event: MessageEvent) => {
    if (event.source === frame.contentWindow && event.data === "ready") frame.contentWindow!.postMessage(report, "*");
  };
  addEventListener("message", ready);
  const close = h("button", { type: "button", class: "close", onclick: () => dialog.close() }, "Close");
  const dialog = openDialog("Report", "wide", close, frame);
  dialog.addEventListener("close", () => removeEventListener("message", ready));
}
