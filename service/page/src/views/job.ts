// The view of a job: its progress and its results.

import { follow } from "../api/events";
import { Problem } from "../api/problem";
import type { Service } from "../api/service";
import type { Job, Progress } from "../api/types";
import { confirmed } from "../parts/dialog";
import { h, setText } from "../parts/dom";
import { moment } from "../parts/format";
import { announce, errorBox } from "../parts/notice";
import { pressButton } from "../parts/press";
import { activity, nextPreset, statusWord, stayWord } from "../parts/words";
import { estimateSection } from "./estimate";
import { failureCard } from "./failure";
import { FindingsSection } from "./findings";
import { LivePanel } from "./live";
import { PhotographsSection } from "./photographs";
import { ResultsPanel } from "./results";
import type { View } from "./view";

/** Return the view of a job. */
export function jobView(service: Service, id: string): View {
  const view = new JobView(service, id);
  return { title: "Job · MGSR", element: view.element, leave: () => view.leave() };
}

class JobView {
  readonly element: HTMLElement;
  private readonly name = h("h1", {}, "Job");
  private readonly status = h("span", { class: "pill" });
  private readonly about = h("span", { class: "note" });
  private readonly actions = h("div", { class: "actions" });
  private readonly trouble = h("div");
  private readonly findings = new FindingsSection();
  private readonly photographs: PhotographsSection;
  private readonly body = h("div", { class: "body" });
  private stop = new AbortController();
  private job: Job | null = null;
  private live: LivePanel | null = null;
  private results: ResultsPanel | null = null;

  constructor(
    private readonly service: Service,
    private readonly id: string,
  ) {
    this.photographs = new PhotographsSection(service, id);
    this.element = h(
      "article",
      { class: "job" },
      h("nav", { "aria-label": "Back" }, h("a", { href: "#/" }, "← All jobs")),
      h("div", { class: "title" }, this.name, h("p", {}, this.status, " ", this.about), this.actions),
      this.trouble,
      this.findings.element,
      this.photographs.element,
      this.body,
    );
    void this.follow();
  }

  leave(): void {
    this.stop.abort();
    this.live?.leave();
    this.results?.leave();
    this.photographs.leave();
  }

  private async follow(): Promise<void> {
    this.stop.abort();
    this.stop = new AbortController();
    const watcher = { job: (job: Job) => this.show(job), progress: (change: Partial<Progress>) => this.change(change) };
    try {
      await follow(this.service, this.id, watcher, this.stop.signal);
    } catch (error) {
      // If the key is refused, the page asks for another one and creates the view again.
      if (!(error instanceof Problem && error.status === 401)) this.trouble.replaceChildren(errorBox(error));
    }
  }

  private change(change: Partial<Progress>): void {
    if (this.job === null) return;
    this.show({ ...this.job, ...change, curve: extended(this.job, change) });
  }

  private show(job: Job): void {
    const before = this.job;
    this.job = job;
    setText(this.name, job.name ?? "Untitled");
    document.title = `${job.name ?? "Job"} · MGSR`;
    setText(this.status, job.cancelling ? "Stopping" : statusWord(job.status));
    this.status.dataset["status"] = job.status;
    setText(this.about, [job.options.preset ?? "", moment(job.created), stayWord(job)].filter(Boolean).join(" · "));
    if (!sameActions(before, job)) this.offerActions(job);
    this.findings.update(job.findings);
    this.photographs.update(job);
    if (job.finished === null) this.showLive(job);
    else if (before === null || before.finished !== job.finished) this.showEnd(job);
    if (before === null || activity(before) !== activity(job) || before.status !== job.status) this.tell(job);
  }

  private showLive(job: Job): void {
    if (this.live === null) {
      this.results?.leave();
      this.results = null;
      this.live = new LivePanel(this.service, job);
      this.body.replaceChildren(this.live.element);
    }
    this.live.update(job);
  }

  private showEnd(job: Job): void {
    this.live?.leave();
    this.live = null;
    if (job.metrics.estimate !== undefined) {
      const start = (preset: string) => this.tried(() => this.rerun(preset));
      this.body.replaceChildren(estimateSection(job.metrics.estimate, start));
    } else if (job.status === "succeeded") {
      this.results = new ResultsPanel(this.service, job);
      this.body.replaceChildren(this.results.element);
    } else {
      this.body.replaceChildren(failureCard(this.service, job));
    }
  }

  private tell(job: Job): void {
    announce(job.finished === null ? activity(job) : `${job.name ?? "The job"}: ${statusWord(job.status)}`);
  }

  private offerActions(job: Job): void {
    const shown: HTMLElement[] = [];
    if (job.finished === null) {
      if (!job.cancelling) shown.push(this.button("Cancel", "", () => this.cancel()));
    } else {
      const again = job.status === "cancelled" || (job.status === "failed" && job.error?.retryable === true);
      if (again) shown.push(this.button("Retry", "main", () => this.retry()));
      const next = job.metrics.estimate === undefined ? nextPreset(job.options.preset ?? "standard") : null;
      if (next !== null) shown.push(this.button(`Run again as ${next}`, again ? "" : "main", () => this.rerun(next)));
      if (job.expires !== null) shown.push(this.button("Keep", "", () => this.pin(true)));
      if (job.pinned) shown.push(this.button("Keep no longer", "", () => this.pin(false)));
      shown.push(this.button("Delete", "", () => this.remove(job)));
    }
    const held = this.actions.contains(document.activeElement);
    this.actions.replaceChildren(...shown);
    if (held) (shown[0] ?? this.name).focus(); // the button that had the focus is gone
  }

  private button(text: string, className: string, act: () => Promise<void>): HTMLButtonElement {
    return pressButton(text, className, () => this.tried(act));
  }

  private async tried(act: () => Promise<void>): Promise<void> {
    this.trouble.replaceChildren();
    await act().catch((error: unknown) => this.trouble.replaceChildren(errorBox(error)));
  }

  private async cancel(): Promise<void> {
    await this.service.cancel(this.id);
    if (this.job !== null && this.job.finished === null) this.show({ ...this.job, cancelling: true });
  }

  private async retry(): Promise<void> {
    await this.service.retry(this.id);
    void this.follow();
  }

  private async rerun(preset: string): Promise<void> {
    location.hash = `#/jobs/${await this.service.rerun(this.id, { preset })}`;
  }

  private async pin(pinned: boolean): Promise<void> {
    this.show(await this.service.pin(this.id, pinned));
  }

  private async remove(job: Job): Promise<void> {
    const text = "This deletes the photographs and all results of the job. You cannot undo it.";
    if (!(await confirmed(`Delete ${job.name ?? "this job"}?`, text, "Delete"))) return;
    await this.service.remove(this.id);
    announce("Deleted");
    location.hash = "#/";
  }
}

/** Return whether two states of a job have the same buttons. */
function sameActions(before: Job | null, job: Job): boolean {
  const names = ["status", "cancelling", "pinned", "expires"] as const;
  return before !== null && names.every((name) => before[name] === job[name]);
}

/** Return the job's curve with the point of a change appended. */
function extended(job: Job, change: Partial<Progress>): Job["curve"] {
  const { losses, training_seconds: seconds, stage, iteration } = change;
  const last = job.curve.at(-1);
  if (!losses || seconds == null || stage == null || iteration == null) return job.curve;
  if (last !== undefined && seconds <= last.seconds) return job.curve;
  const values = Object.values(losses).filter((value) => value !== null);
  const loss = values.reduce((sum, value) => sum + value, 0);
  return [...job.curve, { seconds, stage, iteration, loss, psnr: change.psnr ?? null }];
}
