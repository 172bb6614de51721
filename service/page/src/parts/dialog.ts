// Modal dialogs. The browser keeps the focus inside, and restores it afterwards.

import { h, newId } from "./dom";

/** Open a dialog, which is removed from the page when it closes. */
export function openDialog(title: string, className: string, ...content: HTMLElement[]): HTMLDialogElement {
  const id = newId();
  const dialog = h("dialog", { class: className, "aria-labelledby": id }, h("h2", { id }, title), ...content);
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
  return dialog;
}

/** Ask the user to confirm an action that can't be undone. */
export function confirmed(title: string, text: string, yes: string): Promise<boolean> {
  return new Promise((resolve) => {
    const form = h(
      "form",
      { method: "dialog" },
      h("p", {}, text),
      h(
        "div",
        { class: "actions" },
        h("button", { value: "no", autofocus: true }, "Keep"),
        h("button", { value: "yes", class: "danger" }, yes),
      ),
    );
    const dialog = openDialog(title, "small", form);
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"));
  });
}
