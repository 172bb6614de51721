// Error messages on the page, and announcements for screen readers.

import { byId, h, setText } from "./dom";
import { explain } from "./words";

/** Make screen readers say a text at their next pause. */
export function announce(text: string): void {
  setText(byId("announcer"), text);
}

/** Return a box with an error, its details, and controls that help. */
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
