// The findings of the check of the photographs before training.

import type { Finding } from "../api/types";
import { h } from "../parts/dom";
import { severityWord } from "../parts/words";

const NAMED = 12; // photographs that a finding names before its list is expanded

export class FindingsSection {
  readonly element = h("section", { class: "findings", "aria-label": "Check of the photographs", hidden: true });
  private shown: Finding[] | null = null;

  update(findings: Finding[] | null): void {
    if (findings === this.shown || findings === null) return;
    this.shown = findings;
    this.element.hidden = findings.length === 0;
    this.element.replaceChildren(h("h2", {}, "The photographs"), h("ul", {}, ...findings.map(row)));
  }
}

function row(finding: Finding): HTMLElement {
  const text = finding.text.charAt(0).toUpperCase() + finding.text.slice(1);
  return h(
    "li",
    { class: "notice", "data-severity": finding.severity },
    h("p", { class: "headline" }, `${severityWord(finding.severity)}: ${text}.`),
    h("p", {}, `What to do: ${finding.cure}.`),
    photographs(finding.photographs),
  );
}

function photographs(names: string[]): HTMLElement | null {
  if (names.length === 0) return null;
  if (names.length <= NAMED) return h("p", { class: "note" }, names.join(", "));
  return h("details", { class: "note" }, h("summary", {}, `${names.length} photographs`), names.join(", "));
}
