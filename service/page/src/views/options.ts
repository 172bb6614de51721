// The form for a job's options, made from `GET /options`, so that the settings of a newer service appear by themselves.

import type { JobOptions, Options, SettingSchema, SettingValue } from "../api/types";
import { h, newId } from "../parts/dom";
import { field, labelled, select, type Field } from "../parts/fields";
import { METHODS, PRESETS } from "../parts/words";

/** Frequently used settings, with labels. Settings that the service does not know are omitted. */
const OFTEN: Record<string, { label: string; note: string; words?: Record<string, string> }> = {
  time_budget: { label: "Time budget, seconds", note: "The run chooses its settings to end near this time." },
  "data.max_side": { label: "Longest image side, pixels", note: "Larger photographs are reduced to this size." },
  "data.masks": {
    label: "Masks",
    note: "What the masks of photographs mean.",
    words: { auto: "Detected automatically", object: "White is the object", ignore: "Black is ignored", off: "Not used" },
  },
  "train.background": {
    label: "Background",
    note: "What lies behind the splats in training.",
    words: { auto: "Chosen automatically", random: "Random colours", white: "White", black: "Black" },
  },
  "mesh.max_faces": { label: "Most triangles of the mesh", note: "The mesh is reduced to this number. none: no limit." },
  "mesh.color": {
    label: "Colours of the mesh",
    note: "The object's own colour has no highlights.",
    words: { transmitted: "The object's own colour", full: "As photographed, with reflections" },
  },
  "mesh.close_holes": { label: "Close holes", note: "The mesh also covers places that no photograph shows." },
  "output.texture": { label: "Texture of the model, pixels a side", note: "Without it, as fine as the photographs." },
};
/** The settings for which the form has special controls. */
const ASKED = new Set(["name", "preset", "method", "settings"]);

export class OptionsForm {
  readonly element: HTMLFormElement;
  private readonly name: HTMLInputElement;
  private readonly method: HTMLSelectElement;
  private readonly settings = new Map<string, Field>();
  private readonly others = new Map<string, Field>();

  constructor(
    private readonly options: Options,
    name: string,
  ) {
    this.name = h("input", { id: newId(), value: name, maxlength: 200, autocomplete: "off" });
    this.method = select(Object.keys(options.methods), METHODS, "mgsr");
    this.element = h(
      "form",
      { class: "card options", onchange: () => this.showUsual() },
      labelled("Name", this.name),
      presetChoice(Object.keys(options.presets)),
      h("details", {}, h("summary", {}, "More settings"), this.often(), this.every()),
    );
    // This runs before the browser focuses the first invalid field, which it can't do while the field is hidden.
    this.element.addEventListener("invalid", (event) => reveal(event.target as HTMLElement), true);
    this.showUsual();
  }

  /** Return the chosen options. */
  read(): JobOptions {
    const preset = this.preset();
    const settings = chosen(this.settings);
    return { name: this.name.value.trim() || null, preset, method: this.method.value, settings, ...chosen(this.others) };
  }

  /** Focus the form. */
  focus(): void {
    this.name.focus();
    this.name.select();
  }

  private preset(): string {
    return new FormData(this.element).get("preset") as string;
  }

  private often(): HTMLElement {
    const known = Object.entries(OFTEN).filter(([key]) => key in this.options.settings);
    const fields = known.map(([key, { label, note, words }]) => this.setting(key, label, note, words));
    return h("div", { class: "fields" }, labelled("Method", this.method), ...fields);
  }

  /** Return all other settings by name, with a search field. The section is filled when it is first opened. */
  private every(): HTMLElement {
    const place = h("div", { class: "every" });
    const details = h("details", {}, h("summary", {}, "Every setting"), place);
    details.addEventListener(
      "toggle",
      () => {
        const find = h("input", { type: "search", autocomplete: "off" });
        const groups = this.groups();
        find.addEventListener("input", () => filter(groups, find.value));
        place.append(labelled("Find a setting", find), ...groups);
        this.showUsual();
      },
      { once: true },
    );
    return details;
  }

  private groups(): HTMLElement[] {
    const { properties, $defs } = this.options.options;
    const others = Object.entries(properties).filter(([key]) => !ASKED.has(key));
    const job = others.map(([key, schema]) => this.other(key, resolved(schema, $defs)));
    const groups = new Map<string, HTMLElement[]>([["job", job]]);
    for (const [key, schema] of Object.entries(this.options.settings)) {
      if (key in OFTEN) continue;
      const cut = key.lastIndexOf(".");
      const group = cut < 0 ? "job" : key.slice(0, cut);
      const made = this.setting(key, inWords(key.slice(cut + 1)), schema.description ?? "");
      groups.set(group, [...(groups.get(group) ?? []), made]);
    }
    return [...groups].map(([name, fields]) =>
      h("fieldset", {}, h("legend", {}, inWords(name.replaceAll(".", ", "))), h("div", { class: "fields" }, ...fields)),
    );
  }

  private setting(key: string, label: string, note: string, words?: Record<string, string>): HTMLElement {
    const made = field(label, note, this.options.settings[key]!, words);
    this.settings.set(key, made);
    made.element.dataset["key"] = key;
    return made.element;
  }

  private other(key: string, schema: SettingSchema): HTMLElement {
    const made = field(inWords(key), schema.description ?? "", schema);
    made.setUsual(schema.default);
    this.others.set(key, made);
    made.element.dataset["key"] = key;
    return made.element;
  }

  /** Show the defaults of untouched fields, which depend on preset and method. */
  private showUsual(): void {
    const rows = [this.options.presets[this.preset()], this.options.methods[this.method.value]];
    for (const [key, made] of this.settings) {
      const hits = rows.flatMap((row) => Object.entries(row ?? {}).filter(([name]) => key === name || key.endsWith(`.${name}`)));
      made.setUsual(hits.at(-1)?.[1] ?? this.options.settings[key]!.default);
    }
  }
}

function chosen(fields: Map<string, Field>): Record<string, SettingValue> {
  const values = [...fields].map(([key, one]) => [key, one.read()] as const);
  return Object.fromEntries(values.filter(([, value]) => value !== undefined)) as Record<string, SettingValue>;
}

/** Show only the fields that have the text in their name, label or note. */
function filter(groups: HTMLElement[], text: string): void {
  const wanted = text.trim().toLowerCase();
  for (const group of groups) {
    const fields = [...group.querySelectorAll<HTMLElement>(".field")];
    for (const one of fields) one.hidden = !`${one.dataset["key"]} ${one.textContent}`.toLowerCase().includes(wanted);
    group.hidden = fields.every((one) => one.hidden);
  }
}

/** Show an element by opening all sections around it. */
function reveal(element: HTMLElement): void {
  for (let one: HTMLElement | null = element; one !== null; one = one.parentElement) {
    one.hidden = false;
    if (one instanceof HTMLDetailsElement) one.open = true;
  }
}

function presetChoice(names: string[]): HTMLElement {
  const choices = names.map((name) => {
    const input = h("input", { type: "radio", name: "preset", value: name, checked: name === "standard" });
    return h("label", {}, input, h("span", { class: "name" }, name), h("span", { class: "note" }, PRESETS[name] ?? ""));
  });
  return h("fieldset", { class: "choices" }, h("legend", {}, "Quality"), ...choices);
}

/** Return the schema with its `$ref` resolved, which describes a choice. */
function resolved(schema: SettingSchema, definitions: Record<string, SettingSchema> = {}): SettingSchema {
  const name = schema.$ref?.split("/").at(-1);
  return name === undefined ? schema : { ...definitions[name], ...schema };
}

/** "max_side" is "Max side". */
function inWords(name: string): string {
  const words = name.replaceAll("_", " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}
