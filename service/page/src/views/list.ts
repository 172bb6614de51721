// The jobs, the newest first, kept up to date.

import type { Service } from "../api/service";
import { Unreachable } from "../api/problem";
import type { Job } from "../api/types";
import { h, setText } from "../parts/dom";
import { moment, percent } from "../parts/format";
import { errorBox } from "../parts/notice";
import { activity, remaining, statusWord, stayWord } from "../parts/words";

const PAGE = 20;
const BUSY_PERIOD = 2000;
const IDLE_PERIOD = 10_000;

export class JobListing {
  readonly element: HTMLElement;
  private readonly rows = new Map<string, Row>();
  private readonly list = h("ul", { class: "jobs" });
  private readonly empty = h("p", { class: "note" }, "You have no jobs yet. Your reconstructions will appear here.");
  private readonly trouble = h("div");
  private readonly more = h("button", { type: "button", hidden: true, onclick: () => this.showMore() }, "Show more");
  private limit = PAGE;
  private timer = 0;
  private left = false;

  constructor(private readonly service: Service) {
    this.empty.hidden = true;
    this.element = h(
      "section",
      { "aria-labelledby": "jobs-title" },
      h("h2", { id: "jobs-title" }, "Your jobs"),
      this.trouble,
      this.empty,
      this.list,
      this.more,
    );
    void this.refresh();
  }

  /** Stop updating the list. */
  leave(): void {
    this.left = true;
    clearTimeout(this.timer);
  }

  private showMore(): void {
    this.limit = Math.min(this.limit + 2 * PAGE, 200);
    clearTimeout(this.timer);
    void this.refresh();
  }

  private async refresh(): Promise<void> {
    let period = IDLE_PERIOD;
    try {
      const found = document.hidden ? null : await this.service.jobs(this.limit);
      if (found !== null) this.show(found.jobs, found.next !== null && this.limit < 200);
      this.trouble.replaceChildren();
      if (found?.jobs.some((job) => job.finished === null)) period = BUSY_PERIOD;
    } catch (error) {
      if (error instanceof Unreachable) await this.service.connection.back();
      else this.trouble.replaceChildren(errorBox(error));
      period = BUSY_PERIOD;
    }
    if (!this.left) this.timer = window.setTimeout(() => void this.refresh(), period);
  }

  private show(jobs: Job[], more: boolean): void {
    const known = new Set(jobs.map((job) => job.id));
    for (const id of [...this.rows.keys()].filter((id) => !known.has(id))) {
      this.rows.get(id)!.element.remove();
      this.rows.delete(id);
    }
    jobs.forEach((job, place) => this.place(job, place));
    this.empty.hidden = jobs.length > 0;
    this.more.hidden = !more;
  }

  private place(job: Job, place: number): void {
    let row = this.rows.get(job.id);
    if (row === undefined) {
      row = new Row(job);
      this.rows.set(job.id, row);
    }
    row.update(job);
    // An element that is moved loses the focus.
    if (this.list.children[place] !== row.element) this.list.insertBefore(row.element, this.list.children[place] ?? null);
  }
}

class Row {
  readonly element: HTMLElement;
  private readonly status = h("span", { class: "pill" });
  private readonly note = h("span", { class: "note" });
  private readonly bar = h("progress", { max: 1, "aria-hidden": "true" });

  constructor(job: Job) {
    const name = h("span", { class: "name" }, job.name ?? "Untitled");
    this.element = h("li", {}, h("a", { href: `#/jobs/${job.id}` }, name, this.status, this.note, this.bar));
  }

  update(job: Job): void {
    const running = job.status === "running";
    setText(this.status, statusWord(job.status));
    this.status.dataset["status"] = job.status;
    setText(this.note, running ? describe(job) : job.status === "queued" ? activity(job) : ended(job));
    this.bar.hidden = !running;
    this.bar.value = job.progress;
  }
}

function ended(job: Job): string {
  return [moment(job.created), stayWord(job)].filter(Boolean).join(" · ");
}

function describe(job: Job): string {
  return [percent(job.progress), remaining(job, 0)].filter(Boolean).join(" · ");
}
