// Shows a mesh and splats from the same place: either, or both side by side with a divider to move.
//
// It draws only when something has changed: a page that shows a still object must not heat a phone.

import { PerspectiveCamera, Scene, Sphere, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { h, newId } from "../parts/dom";
import { byKeyboard } from "./keyboard";
import { loadMesh, type MeshObject, type Surface } from "./mesh";
import { loadSplats, type SplatObject } from "./splats";

export type Shown = "mesh" | "splats" | "both";

const SHOWN: Record<Shown, string> = { mesh: "Mesh", splats: "Splats", both: "Side by side" };
const SURFACES: Record<Surface, string> = { colour: "Colour", clay: "Clay", normals: "Normals", wireframe: "Wireframe" };
const HINT = "Turn: drag or arrow keys. Zoom: wheel, pinch, plus or minus. Move: right button, two fingers, or Shift and arrow keys. Reset: Home.";
const FIELD = 40; // degrees
const FIRST_DIRECTION = new Vector3(0.55, 0.4, 1).normalize();
// More pixels than that are not seen, but cost.
const MOST_RATIO = 2;

/** A viewer of a mesh (GLB) and of splats (PLY, in the frame that the GLB's node turns; null for none). Throws where
 * a file can't be read or the browser has no WebGL 2. */
export async function openViewer(mesh: ArrayBuffer, splats: ArrayBuffer | null): Promise<Viewer> {
  const renderer = new WebGLRenderer({ antialias: true, alpha: true });
  const surface = await loadMesh(mesh);
  return new Viewer(renderer, surface, splats);
}

export class Viewer {
  readonly element: HTMLElement;
  private readonly camera = new PerspectiveCamera(FIELD, 1, 0.01, 100);
  private readonly controls: OrbitControls;
  private readonly meshScene = new Scene();
  private readonly splatScene = new Scene();
  private readonly watcher: ResizeObserver;
  private readonly divider = h("input", { type: "range", min: 0, max: 100, value: 50, "aria-label": "Divider between mesh and splats", class: "divider" });
  private readonly hint = h("p", { class: "note hint", id: newId() }, HINT);
  private readonly line = h("div", { class: "line" });
  private splats: SplatObject | null = null;
  private shown: Shown = "mesh";
  private due = 0;
  private placed = false;

  constructor(
    private readonly renderer: WebGLRenderer,
    private readonly mesh: MeshObject,
    splatFile: ArrayBuffer | null,
  ) {
    this.element = h("div", { class: "viewer" }, this.stage(), this.toolbar(splatFile), this.hint);
    this.meshScene.add(mesh.object);
    this.controls = new OrbitControls(this.camera, renderer.domElement);
    this.controls.addEventListener("change", () => this.draw());
    byKeyboard(renderer.domElement, this.controls, mesh.bounds.radius, () => this.home());
    this.watcher = new ResizeObserver(() => this.fit());
    this.watcher.observe(this.element);
    this.setSurface("colour");
    this.show("mesh");
  }

  /** Bring the keyboard to it. */
  focus(): void {
    this.renderer.domElement.focus();
  }

  /** Give back what the graphics card holds. */
  leave(): void {
    cancelAnimationFrame(this.due);
    this.watcher.disconnect();
    this.controls.dispose();
    this.mesh.dispose();
    this.splats?.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  private stage(): HTMLElement {
    const canvas = this.renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application");
    canvas.setAttribute("aria-label", "3D view");
    canvas.setAttribute("aria-describedby", this.hint.id);
    this.divider.addEventListener("input", () => this.draw());
    return h("div", { class: "tile stage" }, canvas, this.line, this.divider);
  }

  private toolbar(splatFile: ArrayBuffer | null): HTMLElement {
    const names = splatFile === null ? { mesh: SHOWN.mesh } : SHOWN;
    const shown = radios("Show", names, "mesh", (value) => void this.choose(value, splatFile));
    const surface = radios("Surface", SURFACES, "colour", (value) => this.setSurface(value));
    const home = h("button", { type: "button", onclick: () => this.home() }, "Reset view");
    return h("div", { class: "toolbar" }, splatFile !== null && shown, surface, home);
  }

  /** Show something; the splats are read when they are first wanted. */
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
    this.draw();
  }

  private setSurface(surface: Surface): void {
    this.mesh.show(surface);
    this.element.dataset["surface"] = surface;
    this.draw();
  }

  private home(): void {
    this.placed = true;
    const { center, radius }: Sphere = this.mesh.bounds;
    const narrow = Math.min(1, this.camera.aspect);
    const distance = (radius * 0.96) / Math.sin(((FIELD / 2) * Math.PI) / 180) / narrow;
    this.camera.position.copy(center).addScaledVector(FIRST_DIRECTION, distance);
    this.camera.near = radius / 100;
    this.camera.far = radius * 100;
    this.camera.updateProjectionMatrix();
    this.controls.target.copy(center);
    this.controls.update();
    this.draw();
  }

  private fit(): void {
    const { clientWidth: width, clientHeight: height } = this.renderer.domElement.parentElement!;
    if (width === 0 || height === 0) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, MOST_RATIO));
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (!this.placed) this.home(); // only now is known how much fits
    this.draw();
  }

  /** Draw with the next frame, once however often it is asked for. */
  private draw(): void {
    if (this.due !== 0) return;
    this.due = requestAnimationFrame(() => {
      this.due = 0;
      this.drawNow();
      this.element.dataset["frames"] = `${Number(this.element.dataset["frames"] ?? 0) + 1}`;
    });
  }

  private drawNow(): void {
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

/** A row of radio buttons. */
function radios<T extends string>(legend: string, choices: Partial<Record<T, string>>, chosen: T, change: (value: T) => void): HTMLElement {
  const name = newId();
  const inputs = (Object.entries(choices) as [T, string][]).map(([value, label]) => {
    const input = h("input", { type: "radio", name, value, checked: value === chosen, onchange: () => change(value) });
    return h("label", {}, input, h("span", {}, label));
  });
  return h("fieldset", { class: "segmented" }, h("legend", {}, legend), ...inputs);
}
