// Starts the page: requests the service's options, then shows the view that the address names.

import { Problem, Unreachable } from "./api/problem";
import { Service } from "./api/service";
import type { Options } from "./api/types";
import { byId, h } from "./parts/dom";
import { announce, errorBox } from "./parts/notice";
import { homeView } from "./views/home";
import { jobView } from "./views/job";
import { askForKey } from "./views/key";
import { UploadTray } from "./views/upload";
import type { View } from "./views/view";

class Page {
  private readonly service = new Service();
  private readonly main = byId("main");
  private readonly tray = new UploadTray(this.service, byId("upload"), (job) => {
    if (atHome()) location.hash = `#/jobs/${job.id}`;
  });
  private options: Options | null = null;
  private view: View | null = null;

  /** Run for as long as the page is open. */
  async run(): Promise<void> {
    addEventListener("hashchange", () => this.show(true));
    this.service.addEventListener("key", () => this.askForKey(this.service.key !== null));
    this.service.connection.addEventListener("change", () => this.tellConnection());
    byId("key-button").addEventListener("click", () => this.askForKey(false));
    document.querySelector(".skip")!.addEventListener("click", (event) => {
      event.preventDefault(); // the address selects the view
      this.main.focus();
    });
    // A file that misses the drop zone would replace the page.
    for (const kind of ["dragover", "drop"]) addEventListener(kind, (event) => event.preventDefault());
    await this.enter();
  }

  /** Request the service's options. Waits if the service does not answer, and asks for its key. */
  private async enter(): Promise<void> {
    for (;;) {
      try {
        this.options = await this.service.options();
        byId("key-button").hidden = this.service.key === null;
        return this.show(false);
      } catch (error) {
        if (!(error instanceof Unreachable)) return this.explain(error);
        await this.service.connection.back();
      }
    }
  }

  private askForKey(wrong: boolean): void {
    askForKey(this.service, wrong, () => void this.enter());
  }

  /** Show why the service refuses the page. */
  private explain(error: unknown): void {
    const keyless = error instanceof Problem && error.status === 401 && this.service.key === null;
    const text = h("p", { class: "lead" }, "This service needs an API key.");
    this.main.replaceChildren(keyless ? text : errorBox(error));
    byId("key-button").hidden = false;
  }

  private show(moved: boolean): void {
    if (this.options === null) return;
    this.view?.leave();
    const job = /^#\/jobs\/([0-9a-f]{32})$/.exec(location.hash)?.[1];
    this.view = job === undefined ? homeView(this.service, this.options, this.tray) : jobView(this.service, job);
    document.title = this.view.title;
    this.main.replaceChildren(this.view.element);
    if (!moved) return;
    scrollTo(0, 0);
    this.main.focus({ preventScroll: true }); // screen readers begin at the top of the new view
  }

  private tellConnection(): void {
    const { up } = this.service.connection;
    const banner = byId("connection");
    banner.dataset["up"] = `${up}`;
    banner.textContent = up ? "" : "The service does not answer. The page keeps trying, and nothing is lost.";
    if (up) announce("The service answers again.");
  }
}

function atHome(): boolean {
  return !location.hash.startsWith("#/jobs/");
}

void new Page().run();
