// The dialog that asks for the API key.

import type { Service } from "../api/service";
import { openDialog } from "../parts/dialog";
import { h, newId } from "../parts/dom";

let open: HTMLDialogElement | null = null;

/** Ask for the key of a service that wants one; `entered` is called when there is a new one. wrong: whether the service
 * has refused the one it was shown. */
export function askForKey(service: Service, wrong: boolean, entered: () => void): void {
  if (open !== null) return;
  const id = newId();
  const field = h("input", {
    id,
    type: "password",
    autocomplete: "off",
    required: true,
    autofocus: true,
    spellcheck: "false",
    "aria-describedby": `${id}-note`,
  });
  const form = h(
    "form",
    { method: "dialog" },
    wrong && h("p", { class: "notice bad", role: "alert" }, "The service does not know this key. Check it and try again."),
    h("label", { for: id }, "API key"),
    field,
    h("p", { class: "note", id: `${id}-note` }, "The key stays in this browser tab until you close it."),
    h("div", { class: "actions" }, h("button", { class: "main", value: "use" }, "Use this key")),
  );
  open = openDialog("This service needs a key", "small", form);
  open.addEventListener("close", () => {
    const taken = open?.returnValue === "use";
    open = null;
    if (!taken) return;
    service.key = field.value.trim();
    entered();
  });
}
