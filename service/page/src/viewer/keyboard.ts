// Keyboard control of the viewer, which OrbitControls lacks.

import { Spherical, Vector3 } from "three";
import type { OrbitControls } from "three/addons/controls/OrbitControls.js";

const TURN = Math.PI / 24;
const ZOOM = 1.12;
const MOVE = 0.06; // of the object's radius
const ARROWS: Record<string, [number, number]> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
};

/** Arrows turn, Shift and arrows move, plus and minus zoom, and Home resets the view. radius: of the object. */
export function byKeyboard(canvas: HTMLElement, controls: OrbitControls, radius: number, home: () => void): void {
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = ARROWS[event.key];
    if (arrow !== undefined) (event.shiftKey ? move : turn)(controls, arrow, radius);
    else if (event.key === "+" || event.key === "=") zoom(controls, 1 / ZOOM);
    else if (event.key === "-") zoom(controls, ZOOM);
    else if (event.key === "Home") home();
    else return;
    event.preventDefault();
  });
}

function turn(controls: OrbitControls, [right, up]: [number, number]): void {
  const offset = controls.object.position.clone().sub(controls.target);
  const place = new Spherical().setFromVector3(offset);
  place.theta += right * TURN;
  place.phi -= up * TURN;
  place.makeSafe();
  controls.object.position.copy(controls.target).add(new Vector3().setFromSpherical(place));
  controls.update();
}

function move(controls: OrbitControls, [right, up]: [number, number], radius: number): void {
  const camera = controls.object;
  const shift = new Vector3(right, up, 0).multiplyScalar(MOVE * radius).applyQuaternion(camera.quaternion);
  camera.position.add(shift);
  controls.target.add(shift);
  controls.update();
}

function zoom(controls: OrbitControls, factor: number): void {
  const offset = controls.object.position.clone().sub(controls.target).multiplyScalar(factor);
  controls.object.position.copy(controls.target).add(offset);
  controls.update();
}
