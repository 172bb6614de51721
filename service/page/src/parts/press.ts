// Buttons whose actions take time. A disabled button would lose the keyboard focus, so presses are ignored instead.

import { h } from "./dom";

/** Run an action at each press of a button, unless the previous one still runs. */
export function onPress(button: HTMLButtonElement, act: () => Promise<void>): void {
  button.addEventListener("click", async () => {
    if (button.ariaDisabled === "true") return;
    button.ariaDisabled = "true";
    try {
      await act();
    } finally {
      button.ariaDisabled = null;
    }
  });
}

/** Create such a button. */
export function pressButton(text: string, className: string, act: () => Promise<void>): HTMLButtonElement {
  const button = h("button", { type: "button", class: className }, text);
  onPress(button, act);
  return button;
}
