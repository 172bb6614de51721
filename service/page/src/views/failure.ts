// A job that failed or was cancelled.

import type { Service } from "../api/service";
import type { Job } from "../api/types";
import { h } from "../parts/dom";
import { bytes } from "../parts/format";
import { troubleWord } from "../parts/words";
import { logSection } from "./log";

/** Return why the job ended, and the remedy. */
export function failureCard(service: Service, job: Job): HTMLElement {
  return h("div", {}, job.error === null ? cancelled() : failed(job), logSection(service, job.id));
}

function cancelled(): HTMLElement {
  return h("div", { class: "notice" }, h("p", { class: "headline" }, "The job was cancelled."), h("p", {}, "A retry continues where it stopped."));
}

function failed(job: Job): HTMLElement {
  const { code, message, retryable, peak_memory_bytes: peak } = job.error!;
  const cure = retryable
    ? "A retry continues from the last checkpoint."
    : "The same capture would fail again. Fix it, and submit it again.";
  return h(
    "div",
    { class: "notice bad" },
    h("p", { class: "headline" }, troubleWord(code) ?? "The job failed."),
    h("p", {}, message),
    h("p", {}, cure),
    h("p", { class: "note" }, `Code: ${code}`, peak === null ? null : ` · peak memory: ${bytes(peak)}`),
  );
}
