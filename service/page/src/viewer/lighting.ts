// The lights for the model's material, and the controls that choose and turn them.

import { DataTexture, EquirectangularReflectionMapping, LinearFilter, PMREMGenerator, type Texture, type WebGLRenderer } from "three";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";
import { EXRLoader } from "three/addons/loaders/EXRLoader.js";
import { h, newId } from "../parts/dom";
import { radios } from "../parts/radios";

/** own: the light of the photographs, from environment.exr. studio: a room with bright panels. */
export type Light = "own" | "studio";

const LIGHTS: Record<Light, string> = { own: "Own light", studio: "Studio light" };
const STEP = 5; // degrees
const BLUR = 0.04; // radians, of the studio's panels
const QUARTER = Math.PI / 2;

/** An environment for a material, and its angle about the vertical axis in radians. */
export interface Environment {
  map: Texture;
  angle: number;
}

/** The controls that choose a light and turn it around the object. */
export class Lighting {
  readonly element: HTMLElement;
  private readonly slider: HTMLInputElement;
  private readonly maps: Partial<Record<Light, Texture>> = {};
  private light: Light;

  /** file: environment.exr, null for none. changed: called when the environment changes. */
  constructor(
    private readonly renderer: WebGLRenderer,
    private readonly file: ArrayBuffer | null,
    changed: () => void,
  ) {
    this.light = file === null ? "studio" : "own";
    const id = newId();
    this.slider = h("input", { type: "range", id, min: 0, max: 360, step: STEP, value: 0 });
    const turned = () => this.slider.setAttribute("aria-valuetext", `${this.slider.value} degrees`);
    turned();
    this.slider.addEventListener("input", () => {
      turned();
      changed();
    });
    const choice = radios("Light", LIGHTS, this.light, (value) => {
      this.light = value;
      changed();
    });
    const turn = h("div", { class: "turn" }, h("label", { for: id }, "Turn the light"), this.slider);
    this.element = h("div", { class: "lighting" }, file !== null && choice, turn);
  }

  /** Return the chosen light. Throws if environment.exr can't be read. */
  environment(): Environment {
    const map = (this.maps[this.light] ??= this.light === "own" ? ownLight(this.file!) : studioLight(this.renderer));
    const turned = (this.slider.valueAsNumber * Math.PI) / 180;
    // The middle column of the file is +z of the model, but three.js expects +x there.
    return { map, angle: this.light === "own" ? turned - QUARTER : turned };
  }
}

function ownLight(file: ArrayBuffer): Texture {
  const { data, width, height, format, type } = new EXRLoader().parse(file);
  const map = new DataTexture(data, width, height, format, type);
  map.mapping = EquirectangularReflectionMapping;
  map.minFilter = map.magFilter = LinearFilter;
  map.needsUpdate = true;
  return map;
}

function studioLight(renderer: WebGLRenderer): Texture {
  const generator = new PMREMGenerator(renderer);
  const room = new RoomEnvironment();
  const { texture } = generator.fromScene(room, BLUR);
  room.dispose();
  generator.dispose();
  return texture;
}
