// The log, which is fetched when the user opens it.

import type { Service } from "../api/service";
import { h } from "../parts/dom";
import { explain } from "../parts/words";

/** Return a section that expands to the job's log. */
export function logSection(service: Service, job: string): HTMLElement {
  const text = h("pre", { tabindex: 0, role: "region", "aria-label": "Log" });
  const section = h("details", { class: "log" }, h("summary", {}, "Log"), text);
  section.addEventListener("toggle", async () => {
    if (!section.open) return;
    text.textContent = await service.log(job).catch((error: unknown) => explain(error).headline);
  });
  return section;
}
