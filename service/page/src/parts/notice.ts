// Errors on the page, and what screen readers are told.

import { byId, h, setText } from "./dom";
import { explain } from "./words";

/** Have screen readers say something when they next pause. */
export function announce(text: string): void {
  setText(byId("announcer"), text);
}

/** A box that tells of an error, with its details, and perhaps what to do. */
export function errorBox(error: unknown, ...actions: HTMLElement[]): HTMLElement {
  const { headline, detail } = explain(error);
  return h(
    "div",
    { class: "notice bad", role: "alert" },
    h("p", { class: "headline" }, headline),
    detail !== null && h("p", { class: "note" }, detail),
    actions.length > 0 && h("div", { class: "actions" }, ...actions),
  );
}
