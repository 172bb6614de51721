// Buttons whose work takes a while. A button that is disabled would lose the keyboard's focus, so it stays, and is deaf.

import { h } from "./dom";

/** Do something at each press of a button, but not before the last is done. */
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

/** A button that does so. */
export function pressButton(text: string, className: string, act: () => Promise<void>): HTMLButtonElement {
  const button = h("button", { type: "button", class: className }, text);
  onPress(button, act);
  return button;
}
