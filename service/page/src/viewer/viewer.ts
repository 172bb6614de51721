// Shows a mesh and splats from the same camera: either of them, or both side by side with a movable divider.

import { Scene, Sphere, Vector3, WebGLRenderer } from "three";
import { h } from "../parts/dom";
import { radios } from "../parts/radios";
import { Lighting } from "./lighting";
import { loadMesh, type MeshObject, type Surface } from "./mesh";
import { OrbitView } from "./orbit";
import { loadSplats, type SplatObject } from "./splats";

export type Shown = "mesh" | "splats" | "both";

const SHOWN: Record<Shown, string> = { mesh: "Mesh", splats: "Splats", both: "Side by side" };
const SURFACES: Record<Surface, string> = { colour: "Colour", lit: "Lit", clay: "Clay", normals: "Normals", wireframe: "Wireframe" };
const HINT = "Turn: drag or arrow keys. Zoom: wheel, pinch, plus or minus. Move: right button, two fingers, or Shift and arrow keys. Reset: Home.";
const FIRST_DIRECTION = new Vector3(0.55, 0.4, 1).normalize();

/** The contents of a job's files; null for what it does not have. mesh: GLB. splats: PLY, in the frame that the GLB's
 * node turns. environment: EXR, in the frame that it turns to. */
export interface Files {
  mesh: ArrayBuffer;
  splats: ArrayBuffer | null;
  environment: ArrayBuffer | null;
}

/** A viewer of a mesh and of splats. Throws if a file can't be read or the browser has no WebGL 2. */
export async function openViewer({ mesh, splats, environment }: Files): Promise<Viewer> {
  const renderer = new WebGLRenderer({ antialias: true, alpha: true });
  const surface = await loadMesh(mesh);
  return new Viewer(renderer, surface, splats, environment);
}

export class Viewer extends OrbitView {
  readonly element: HTMLElement;
  private readonly meshScene = new Scene();
  private readonly splatScene = new Scene();
  private readonly divider = h("input", { type: "range", min: 0, max: 100, value: 50, "aria-label": "Divider between mesh and splats", class: "divider" });
  private readonly line = h("div", { class: "line" });
  private splats: SplatObject | null = null;
  private readonly lighting: Lighting;
  private shown: Shown = "mesh";
  private surface: Surface = "colour";

  constructor(
    renderer: WebGLRenderer,
    private readonly mesh: MeshObject,
    splatFile: ArrayBuffer | null,
    environment: ArrayBuffer | null,
  ) {
    super(renderer, "3D view", HINT, mesh.bounds.radius);
    this.lighting = new Lighting(renderer, environment, () => this.setSurface(this.surface));
    this.element = h("div", { class: "viewer" }, this.stage(), this.toolbar(splatFile), this.lighting.element, this.hint);
    this.meshScene.add(mesh.object);
    this.watch();
    this.setSurface("colour");
    this.show("mesh");
  }

  /** Focus the viewer. */
  focus(): void {
    this.renderer.domElement.focus();
  }

  override leave(): void {
    this.mesh.dispose();
    this.splats?.dispose();
    super.leave();
  }

  private stage(): HTMLElement {
    this.divider.addEventListener("input", () => this.draw());
    return h("div", { class: "tile stage" }, this.renderer.domElement, this.line, this.divider);
  }

  private toolbar(splatFile: ArrayBuffer | null): HTMLElement {
    const names = splatFile === null ? { mesh: SHOWN.mesh } : SHOWN;
    const shown = radios("Show", names, "mesh", (value) => void this.choose(value, splatFile));
    const surface = radios("Surface", SURFACES, "colour", (value) => this.setSurface(value));
    const home = h("button", { type: "button", onclick: () => this.home() }, "Reset view");
    return h("div", { class: "toolbar" }, splatFile !== null && shown, surface, home);
  }

  /** Show mesh, splats or both. The splats are read when they are first needed. */
  private async choose(shown: Shown, splatFile: ArrayBuffer | null): Promise<void> {
    if (shown !== "mesh" && this.splats === null && splatFile !== null) {
      this.element.setAttribute("aria-busy", "true");
      this.splats = await loadSplats(this.renderer, splatFile, this.mesh.placement, () => this.draw());
      this.splatScene.add(this.splats.object);
      this.element.removeAttribute("aria-busy");
    }
    this.show(shown);
  }

  private show(shown: Shown): void {
    this.shown = shown;
    this.element.dataset["shown"] = shown;
    this.divider.hidden = this.line.hidden = shown !== "both";
    this.refresh();
  }

  private setSurface(surface: Surface): void {
    this.surface = surface;
    this.mesh.show(surface);
    if (surface === "lit") this.mesh.light(this.lighting.environment());
    this.element.dataset["surface"] = surface;
    this.refresh();
  }

  private refresh(): void {
    this.lighting.element.hidden = this.surface !== "lit" || this.shown === "splats";
    this.draw();
  }

  protected override place(): void {
    const { center, radius }: Sphere = this.mesh.bounds;
    this.camera.position.copy(center).addScaledVector(FIRST_DIRECTION, this.distanceTo(0.96 * radius));
    this.camera.near = radius / 100;
    this.camera.far = radius * 100;
    this.camera.updateProjectionMatrix();
    this.controls.target.copy(center);
  }

  protected override drawNow(): void {
    const { domElement: canvas } = this.renderer;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const share = this.divider.valueAsNumber / 100;
    const middle = this.shown === "both" ? Math.round(width * share) : this.shown === "mesh" ? width : 0;
    this.line.style.left = `${middle}px`;
    this.renderer.setScissorTest(true);
    if (middle > 0) this.drawPart(this.meshScene, 0, middle, height);
    if (middle < width) this.drawPart(this.splatScene, middle, width - middle, height);
  }

  private drawPart(scene: Scene, left: number, width: number, height: number): void {
    this.renderer.setScissor(left, 0, width, height);
    this.renderer.render(scene, this.camera);
  }
}
