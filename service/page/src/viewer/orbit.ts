// A canvas that shows an object in 3D, from a camera that the user moves around it.
//
// It draws only when something has changed, because a page with a still object must not heat a phone.

import { PerspectiveCamera, type WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { h, newId } from "../parts/dom";
import { byKeyboard } from "./keyboard";

const FIELD = 40; // degrees
const MOST_RATIO = 2; // device pixels per CSS pixel; more cost time without being visible

/** A view with its canvas. name: of the canvas, for screen readers. instructions: how to move. radius: of what is
 * looked at. A subclass makes the element and calls `watch` at the end of its constructor. */
export abstract class OrbitView {
  abstract readonly element: HTMLElement;
  protected readonly camera = new PerspectiveCamera(FIELD, 1, 0.01, 100);
  protected readonly controls: OrbitControls;
  protected readonly hint: HTMLElement;
  private readonly watcher = new ResizeObserver(() => this.fit());
  private due = 0;
  private placed = false;

  constructor(
    protected readonly renderer: WebGLRenderer,
    name: string,
    instructions: string,
    radius: number,
  ) {
    const canvas = renderer.domElement;
    this.hint = h("p", { class: "note hint", id: newId() }, instructions);
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application");
    canvas.setAttribute("aria-label", name);
    canvas.setAttribute("aria-describedby", this.hint.id);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.draw());
    byKeyboard(canvas, this.controls, radius, () => this.home());
  }

  /** Reset the camera to its first place. */
  protected abstract place(): void;

  /** Draw immediately. */
  protected abstract drawNow(): void;

  /** Free the memory on the graphics card. */
  leave(): void {
    cancelAnimationFrame(this.due);
    this.watcher.disconnect();
    this.controls.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  protected watch(): void {
    this.watcher.observe(this.element);
  }

  protected home(): void {
    this.placed = true;
    this.place();
    this.controls.update();
    this.draw();
  }

  /** Return the distance from which a ball fills the narrower side of the canvas. */
  protected distanceTo(radius: number): number {
    return radius / Math.sin(((FIELD / 2) * Math.PI) / 180) / Math.min(1, this.camera.aspect);
  }

  /** Draw with the next frame. Several calls draw only once. */
  protected draw(): void {
    if (this.due !== 0) return;
    this.due = requestAnimationFrame(() => {
      this.due = 0;
      this.drawNow();
      this.element.dataset["frames"] = `${Number(this.element.dataset["frames"] ?? 0) + 1}`;
    });
  }

  private fit(): void {
    const { clientWidth: width, clientHeight: height } = this.renderer.domElement.parentElement!;
    if (width === 0 || height === 0) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, MOST_RATIO));
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (!this.placed) this.home(); // the distance depends on the canvas's size, which is known only now
    this.draw();
  }
}
