// The cameras of a capture as pyramids with their photographs, the region that is reconstructed, and the places from
// which photographs are missing.

import {
  BufferAttribute,
  BufferGeometry,
  CanvasTexture,
  Color,
  DoubleSide,
  Group,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  MeshBasicMaterial,
  Points,
  PointsMaterial,
  Quaternion,
  Raycaster,
  SRGBColorSpace,
  Scene,
  SphereGeometry,
  Vector2,
  Vector3,
  WebGLRenderer,
  WireframeGeometry,
} from "three";
import type { Finding, Photograph, Photographs, Place } from "../api/types";
import { h } from "../parts/dom";
import { OrbitView } from "./orbit";

const HINT = "Turn: drag or arrow keys. Zoom: wheel, pinch, plus or minus. Choose a camera: click. Reset: Home.";
const FIRST_DIRECTION = new Vector3(0.4, 0.55, 1).normalize();
const DEPTH = 0.13; // of a pyramid; the farthest camera is at distance 1
const CLICK = 4; // pixels that the pointer may move in a click
const COLORS: Record<Finding["severity"], string> = { error: "--bad", warning: "--bad", note: "--accent" };

/** A view of cameras. severities: of the worst finding on each; missing: places without photographs; chosen: called
 * with the index of the photograph that a person clicks. Throws if the browser has no WebGL 2. */
export function openCameras(
  found: Photographs,
  severities: (Finding["severity"] | null)[],
  missing: Place[],
  chosen: (index: number) => void,
): CameraView {
  return new CameraView(new WebGLRenderer({ antialias: true, alpha: true }), found, severities, missing, chosen);
}

export class CameraView extends OrbitView {
  readonly element: HTMLElement;
  private readonly scene = new Scene();
  private readonly pictures: Mesh<BufferGeometry, MeshBasicMaterial>;
  private readonly highlight: LineSegments<BufferGeometry, LineBasicMaterial>;
  private readonly corners: Vector3[][];
  private readonly middle = new Vector3(); // between the centres of the region and of the cameras

  constructor(
    renderer: WebGLRenderer,
    private readonly found: Photographs,
    severities: (Finding["severity"] | null)[],
    missing: Place[],
    private readonly chosen: (index: number) => void,
  ) {
    super(renderer, "Cameras in 3D", HINT, 1);
    const world = new Frame(found);
    this.corners = found.photographs.map((photo) => pyramid(photo, world));
    for (const [apex] of this.corners) this.middle.addScaledVector(apex!, 0.5 / this.corners.length);
    this.pictures = pictureQuads(this.corners, found);
    this.highlight = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ color: themeColor("--ink") }));
    const group = new Group().add(this.pictures, this.highlight, region(found.radius * world.scale));
    group.add(edges(this.corners, severities), places(missing.map((place) => world.place(place))));
    this.scene.add(group);
    this.element = h("div", { class: "viewer" }, h("div", { class: "tile stage" }, renderer.domElement), this.hint);
    this.listenForClicks(renderer.domElement);
    this.watch();
  }

  /** Show the pictures of a sheet in the pyramids. */
  async paint(sheet: Blob): Promise<void> {
    const bitmap = await createImageBitmap(sheet);
    const canvas = h("canvas", { width: bitmap.width, height: bitmap.height });
    canvas.getContext("2d")!.drawImage(bitmap, 0, 0);
    bitmap.close();
    const texture = new CanvasTexture(canvas);
    texture.colorSpace = SRGBColorSpace;
    this.pictures.material.map?.dispose();
    this.pictures.material.map = texture;
    this.pictures.material.needsUpdate = true;
    this.pictures.visible = true;
    this.draw();
  }

  /** Highlight a camera. */
  select(index: number): void {
    const far = this.corners[index]!;
    this.highlight.geometry.dispose();
    this.highlight.geometry = lines([outline(far.map((corner) => corner.clone().lerp(far[0]!, -0.25)))]);
    this.element.dataset["selected"] = this.found.photographs[index]!.name;
    this.draw();
  }

  override leave(): void {
    this.pictures.material.map?.dispose();
    super.leave();
  }

  private listenForClicks(canvas: HTMLCanvasElement): void {
    let down = new Vector2();
    canvas.addEventListener("pointerdown", (event) => {
      down = new Vector2(event.clientX, event.clientY);
    });
    canvas.addEventListener("click", (event) => {
      if (down.distanceTo(new Vector2(event.clientX, event.clientY)) > CLICK) return;
      const box = canvas.getBoundingClientRect();
      const across = ((event.clientX - box.left) / box.width) * 2 - 1;
      const caster = new Raycaster();
      caster.setFromCamera(new Vector2(across, 1 - ((event.clientY - box.top) / box.height) * 2), this.camera);
      const face = caster.intersectObject(this.pictures)[0]?.faceIndex;
      if (face !== undefined && face !== null) this.chosen(Math.floor(face / 2));
    });
  }

  protected override place(): void {
    this.controls.target.copy(this.middle);
    this.camera.position.copy(this.middle).addScaledVector(FIRST_DIRECTION, this.distanceTo(1.05));
  }

  protected override drawNow(): void {
    this.renderer.render(this.scene, this.camera);
  }
}

/** The frame of the view: the region's centre is the origin, the farthest camera is at 1, and photographs are upright. */
class Frame {
  readonly scale: number;
  private readonly middle: Vector3;
  private readonly turn: Quaternion;

  constructor(found: Photographs) {
    this.middle = new Vector3(...found.middle);
    const away = found.photographs.map(({ center }) => new Vector3(...center).distanceTo(this.middle));
    this.scale = 1 / Math.max(found.radius, ...away);
    const up = new Vector3();
    for (const photo of found.photographs) up.add(new Vector3(...photo.up));
    this.turn = new Quaternion().setFromUnitVectors(up.normalize(), new Vector3(0, 1, 0));
  }

  place(place: Place): Vector3 {
    return new Vector3(...place).sub(this.middle).multiplyScalar(this.scale).applyQuaternion(this.turn);
  }

  direction(direction: Place): Vector3 {
    return new Vector3(...direction).applyQuaternion(this.turn);
  }
}

/** Return apex and corners of a camera's pyramid: upper left, upper right, lower right, lower left. */
function pyramid(photo: Photograph, frame: Frame): Vector3[] {
  const [apex, forward, up] = [frame.place(photo.center), frame.direction(photo.direction), frame.direction(photo.up)];
  const right = new Vector3().crossVectors(forward, up);
  const [across, down] = photo.angles.map((angle) => Math.tan((angle * Math.PI) / 360));
  const steps = [[-1, 1], [1, 1], [1, -1], [-1, -1]] as const;
  const corners = steps.map(([x, y]) => {
    const ray = forward.clone().addScaledVector(right, x * across!).addScaledVector(up, y * down!);
    return apex.clone().addScaledVector(ray, DEPTH);
  });
  return [apex, ...corners];
}

/** Return the lines of a pyramid, each as two ends. */
function outline([apex, ...corners]: Vector3[]): Vector3[] {
  return corners.flatMap((corner, i) => [apex!, corner, corner, corners[(i + 1) % 4]!]);
}

function lines(ends: Vector3[][]): BufferGeometry {
  return new BufferGeometry().setFromPoints(ends.flat());
}

function edges(corners: Vector3[][], severities: (Finding["severity"] | null)[]): LineSegments {
  const geometry = lines(corners.map(outline));
  const each = geometry.getAttribute("position").count / corners.length;
  const colors = severities.flatMap((severity) => {
    const { r, g, b } = themeColor(severity === null ? "--edge" : COLORS[severity]);
    return Array.from({ length: each }, () => [r, g, b]).flat();
  });
  geometry.setAttribute("color", new BufferAttribute(new Float32Array(colors), 3));
  return new LineSegments(geometry, new LineBasicMaterial({ vertexColors: true }));
}

/** The image planes of all pyramids, hidden until they have a sheet. */
function pictureQuads(corners: Vector3[][], found: Photographs): Mesh<BufferGeometry, MeshBasicMaterial> {
  const geometry = lines(corners.map(([, ...far]) => far));
  const rows = Math.ceil(corners.length / found.columns);
  const uvs = found.photographs.flatMap(({ angles }, i) => {
    const [across, down] = angles.map((angle) => Math.tan((angle * Math.PI) / 360));
    const [width, height] = [Math.min(1, across! / down!) / 2, Math.min(1, down! / across!) / 2];
    const [x, y] = [(i % found.columns) + 0.5, Math.floor(i / found.columns) + 0.5];
    const [left, right] = [(x - width) / found.columns, (x + width) / found.columns];
    const [top, bottom] = [1 - (y - height) / rows, 1 - (y + height) / rows];
    return [left, top, right, top, right, bottom, left, bottom];
  });
  geometry.setAttribute("uv", new BufferAttribute(new Float32Array(uvs), 2));
  geometry.setIndex(corners.flatMap((_, i) => [0, 1, 2, 0, 2, 3].map((corner) => 4 * i + corner)));
  const quads = new Mesh(geometry, new MeshBasicMaterial({ side: DoubleSide, transparent: true, alphaTest: 0.5 }));
  quads.visible = false;
  return quads;
}

function region(radius: number): LineSegments {
  const ball = new WireframeGeometry(new SphereGeometry(radius, 16, 8));
  return new LineSegments(ball, new LineBasicMaterial({ color: themeColor("--accent"), transparent: true, opacity: 0.3 }));
}

function places(missing: Vector3[]): Points {
  const material = new PointsMaterial({ color: themeColor("--bad"), size: 10, sizeAttenuation: false });
  return new Points(new BufferGeometry().setFromPoints(missing), material);
}

/** Return a colour of the page's style. */
function themeColor(name: string): Color {
  return new Color(getComputedStyle(document.documentElement).getPropertyValue(name).trim());
}
