// The form for a job's options, made of what `GET /options` says.

import type { JobOptions, Options, SettingSchema, SettingValue } from "../api/types";
import { h, newId } from "../parts/dom";
import { METHODS, PRESETS } from "../parts/words";

/** The settings that people often want, and what they are called. What the service does not know is left out. */
const OFTEN: Record<string, { label: string; note: string; words?: Record<string, string> }> = {
  "data.max_side": { label: "Longest image side, pixels", note: "Larger photographs are shrunk to it." },
  "data.masks": {
    label: "Masks",
    note: "What lies outside of the object.",
    words: { auto: "Use them where there are any", off: "Do not use them", require: "Every photograph must have one" },
  },
  "train.background": {
    label: "Background",
    note: "Behind the object, where masks cut it out.",
    words: { auto: "Chosen for the capture", random: "Random colours", white: "White", black: "Black" },
  },
  "mesh.max_faces": { label: "Most triangles of the mesh", note: "Empty: as many as the detail needs." },
  "mesh.color": {
    label: "Colours of the mesh",
    note: "The object's own colour has no highlights baked in.",
    words: { transmitted: "The object's own colour", full: "As photographed, with reflections" },
  },
  "mesh.close_holes": { label: "Close holes", note: "Also where no photograph saw the surface." },
};

interface Field {
  element: HTMLElement;
  /** undefined: as the preset has it. */
  read(): SettingValue | undefined;
}

export class OptionsForm {
  readonly element: HTMLFormElement;
  private readonly name: HTMLInputElement;
  private readonly fields: Map<string, Field>;
  private readonly method: HTMLSelectElement;

  constructor(options: Options, name: string) {
    this.name = h("input", { id: newId(), value: name, maxlength: 200, autocomplete: "off" });
    this.method = select(Object.keys(options.methods), METHODS, "mgsr");
    this.fields = new Map(
      Object.entries(OFTEN)
        .filter(([key]) => key in options.settings)
        .map(([key, { label, note, words }]) => [key, field(label, note, options.settings[key]!, words ?? {})]),
    );
    this.element = h(
      "form",
      { class: "card options" },
      labelled("Name", this.name),
      presetChoice(Object.keys(options.presets)),
      h(
        "details",
        {},
        h("summary", {}, "More settings"),
        h("div", { class: "fields" }, labelled("Method", this.method), ...[...this.fields.values()].map((one) => one.element)),
      ),
    );
  }

  /** What was chosen. */
  read(): JobOptions {
    const chosen = [...this.fields].map(([key, one]) => [key, one.read()] as const).filter(([, value]) => value !== undefined);
    const preset = new FormData(this.element).get("preset") as string;
    const settings = Object.fromEntries(chosen) as Record<string, SettingValue>;
    return { name: this.name.value.trim() || null, preset, method: this.method.value, settings };
  }

  /** Bring the keyboard to it. */
  focus(): void {
    this.name.focus();
    this.name.select();
  }
}

function presetChoice(names: string[]): HTMLElement {
  const choices = names.map((name) => {
    const input = h("input", { type: "radio", name: "preset", value: name, checked: name === "standard" });
    return h("label", {}, input, h("span", { class: "name" }, name), h("span", { class: "note" }, PRESETS[name] ?? ""));
  });
  return h("fieldset", { class: "choices" }, h("legend", {}, "Quality"), ...choices);
}

function field(label: string, note: string, schema: SettingSchema, words: Record<string, string>): Field {
  if (schema.enum !== undefined) return choice(label, note, schema, words);
  return schema.type === "boolean" ? tick(label, note, schema) : number(label, note, schema);
}

function choice(label: string, note: string, schema: SettingSchema, words: Record<string, string>): Field {
  const input = select(schema.enum!, words, `${schema.default}`);
  return {
    element: labelled(label, input, note),
    read: () => (input.value === schema.default ? undefined : input.value),
  };
}

function tick(label: string, note: string, schema: SettingSchema): Field {
  const input = h("input", { type: "checkbox", checked: schema.default === true });
  return {
    element: h("label", { class: "tick" }, input, h("span", {}, label), h("span", { class: "note" }, note)),
    read: () => (input.checked === schema.default ? undefined : input.checked),
  };
}

function number(label: string, note: string, schema: SettingSchema): Field {
  const kinds = schema.anyOf ?? [schema];
  const [kind] = kinds.filter(({ type }) => type !== "null");
  const step = kind?.type === "integer" ? 1 : "any";
  const usual = schema.default === null ? "" : `${schema.default}`;
  const optional = kinds.some(({ type }) => type === "null");
  const input = h("input", { type: "number", min: kind?.minimum, step, value: usual, required: !optional, inputmode: "decimal" });
  return {
    element: labelled(label, input, note),
    read: () => (input.value === usual ? undefined : input.value === "" ? null : input.valueAsNumber),
  };
}

function select(values: string[], words: Record<string, string>, chosen: string): HTMLSelectElement {
  const options = values.map((value) => h("option", { value, selected: value === chosen }, words[value] ?? value));
  return h("select", {}, ...options);
}

function labelled(label: string, control: HTMLElement, note?: string): HTMLElement {
  const id = control.id || newId();
  control.id = id;
  if (note !== undefined) control.setAttribute("aria-describedby", `${id}-note`);
  return h(
    "div",
    { class: "field" },
    h("label", { for: id }, label),
    control,
    note !== undefined && h("span", { class: "note", id: `${id}-note` }, note),
  );
}
