// A choice between a few visible options.

import { h, newId } from "./dom";

/** Create a row of radio buttons. */
export function radios<T extends string>(legend: string, choices: Partial<Record<T, string>>, chosen: T, change: (value: T) => void): HTMLElement {
  const name = newId();
  const inputs = (Object.entries(choices) as [T, string][]).map(([value, label]) => {
    const input = h("input", { type: "radio", name, value, checked: value === chosen, onchange: () => change(value) });
    return h("label", {}, input, h("span", {}, label));
  });
  return h("fieldset", { class: "segmented" }, h("legend", {}, legend), ...inputs);
}
