// Tracks whether the service answers. After a failed request, the page polls the service until it answers again.

const FIRST_PAUSE = 1000;
const LONGEST_PAUSE = 5000;

export class Connection extends EventTarget {
  private answering = true;

  /** Whether the service answered the last request. */
  get up(): boolean {
    return this.answering;
  }

  /** Report that the service did not answer. Dispatches `change` now, and again when it is back. */
  lost(): void {
    if (!this.answering) return;
    this.answering = false;
    this.dispatchEvent(new Event("change"));
    this.ask(FIRST_PAUSE);
  }

  /** Resolve once the service answers, at once if it already does. */
  back(signal?: AbortSignal): Promise<void> {
    if (this.answering) return Promise.resolve();
    return new Promise((resolve, reject) => {
      const done = () => (this.answering ? resolve() : undefined);
      this.addEventListener("change", done, { once: true });
      signal?.addEventListener("abort", () => {
        this.removeEventListener("change", done);
        reject(signal.reason);
      });
    });
  }

  private ask(pause: number): void {
    setTimeout(async () => {
      if (await answers()) {
        this.answering = true;
        this.dispatchEvent(new Event("change"));
      } else {
        this.ask(Math.min(pause * 1.5, LONGEST_PAUSE));
      }
    }, pause);
  }
}

async function answers(): Promise<boolean> {
  try {
    return (await fetch("/healthz", { cache: "no-store", signal: AbortSignal.timeout(LONGEST_PAUSE) })).ok;
  } catch {
    return false;
  }
}
