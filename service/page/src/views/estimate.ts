// The estimates of a dry run for each preset.

import type { Estimate } from "../api/types";
import { h } from "../parts/dom";
import { bytes, duration } from "../parts/format";
import { pressButton } from "../parts/press";
import { PRESETS } from "../parts/words";

/** Return the presets with their time and memory, each with a button that starts it. */
export function estimateSection(estimates: Estimate[], start: (preset: string) => Promise<void>): HTMLElement {
  return h(
    "section",
    { class: "estimates", "aria-labelledby": "estimate-title" },
    h("h2", { id: "estimate-title" }, "Time and memory"),
    h("ul", {}, ...estimates.map((estimate) => row(estimate, start))),
    h("p", { class: "note" }, "These estimates are for the worker of this dry run. Training ends early if it has converged."),
  );
}

function row({ preset, seconds, memory_mib: memory }: Estimate, start: (preset: string) => Promise<void>): HTMLElement {
  return h(
    "li",
    { class: "card" },
    h("p", { class: "headline" }, `${preset}: up to about ${duration(seconds)}, ${bytes(memory * 2 ** 20)} of memory`),
    h("p", { class: "note" }, PRESETS[preset]),
    pressButton(`Run as ${preset}`, preset === "standard" ? "main" : "", () => start(preset)),
  );
}
