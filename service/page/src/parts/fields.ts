// The fields of a form, made from a JSON schema. An untouched field has no value, and the default applies.

import type { SettingSchema, SettingValue } from "../api/types";
import { h, newId } from "./dom";

export interface Field {
  element: HTMLElement;
  /** The value; undefined if the field is untouched. */
  read(): SettingValue | undefined;
  /** Show the default that applies if the field is untouched. */
  setUsual(value: SettingValue | undefined): void;
}

/** Create a field for a setting. words: the labels of a choice's values; a value without one is shown as it is. */
export function field(label: string, note: string, schema: SettingSchema, words: Record<string, string> = {}): Field {
  const kinds = (schema.anyOf ?? [schema]).filter(({ type }) => type !== "null");
  const optional = kinds.length < (schema.anyOf?.length ?? 1);
  const kind = kinds[0] ?? {};
  if (kind.type === "boolean") return choice(label, note, ["on", "off"], optional, words);
  if (kind.enum !== undefined) return choice(label, note, kind.enum, optional, words);
  return entry(label, note, kind, optional);
}

/** Return a control below its label, with a note. */
export function labelled(label: string, control: HTMLElement, note = ""): HTMLElement {
  const id = control.id || newId();
  control.id = id;
  if (note !== "") control.setAttribute("aria-describedby", `${id}-note`);
  return h(
    "div",
    { class: "field" },
    h("label", { for: id }, label),
    control,
    note !== "" && h("span", { class: "note", id: `${id}-note` }, note),
  );
}

export function select(values: string[], words: Record<string, string>, chosen: string): HTMLSelectElement {
  const options = values.map((value) => h("option", { value, selected: value === chosen }, words[value] ?? value));
  return h("select", {}, ...options);
}

const SWITCH: Record<string, boolean> = { on: true, off: false };

function choice(label: string, note: string, names: string[], optional: boolean, words: Record<string, string>): Field {
  const input = select([LEFT_ALONE, ...names, ...(optional ? [NONE] : [])], words, LEFT_ALONE);
  const usual = input.options[0]!;
  const isSwitch = names.every((name) => name in SWITCH);
  return {
    element: labelled(label, input, note),
    read: () => {
      if (input.value === LEFT_ALONE) return undefined;
      if (input.value === NONE) return null;
      return isSwitch ? SWITCH[input.value]! : input.value;
    },
    setUsual: (value) => (usual.textContent = `${words[shown(value)] ?? shown(value)} (default)`),
  };
}

const LEFT_ALONE = "";
const NONE = "none";
const PATTERNS: Record<string, string> = { integer: "-?\\d+", number: "-?\\d*\\.?\\d+([eE][+\\-]?\\d+)?" };

function entry(label: string, note: string, kind: SettingSchema, optional: boolean): Field {
  const digits = PATTERNS[kind.type ?? ""];
  const pattern = digits !== undefined && optional ? `${digits}|${NONE}` : digits;
  const title = digits === undefined ? null : `${kind.type === "integer" ? "a whole number" : "a number"}${optional ? `, or ${NONE}` : ""}`;
  const input = h("input", { pattern, title, inputmode: digits === undefined ? null : "decimal", autocomplete: "off" });
  return {
    element: labelled(label, input, note),
    read: () => {
      const text = input.value.trim();
      if (text === LEFT_ALONE) return undefined;
      if (optional && text === NONE) return null;
      return digits === undefined ? text : Number(text);
    },
    setUsual: (value) => (input.placeholder = shown(value)),
  };
}

function shown(value: SettingValue | undefined): string {
  if (typeof value === "boolean") return value ? "on" : "off";
  return value === null || value === undefined ? NONE : `${value}`;
}
