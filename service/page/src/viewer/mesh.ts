// The mesh of a GLB that MGSR writes: one node, one material with its maps.

import { DirectionalLight, DoubleSide, Group, HemisphereLight, Mesh, MeshBasicMaterial, MeshNormalMaterial, TextureLoader } from "three";
import { MeshStandardMaterial, type Material, type Object3D, type Quaternion, type Sphere, type Vector3 } from "three";
import { GLTFLoader, type GLTFLoaderPlugin, type GLTFParser } from "three/addons/loaders/GLTFLoader.js";
import type { Environment } from "./lighting";

/** colour: without lights. lit: the material in an environment. clay: grey under lights, to show the shape. */
export type Surface = "colour" | "lit" | "clay" | "normals" | "wireframe";

/** The transform from the cameras' frame to the scene: a rotation, then a move by `shift`. */
export interface Placement {
  turn: Quaternion;
  shift: Vector3;
}

export class MeshObject {
  readonly object = new Group();
  readonly bounds: Sphere;
  private readonly own: MeshStandardMaterial;
  private readonly materials: Record<Surface, Material>;
  private readonly lamps = new Group().add(new HemisphereLight(0xffffff, 0x8d8a85, 1.6), keyLight());

  constructor(
    private readonly mesh: Mesh,
    readonly placement: Placement,
  ) {
    this.own = mesh.material as MeshStandardMaterial;
    const { map, normalMap } = this.own;
    this.materials = {
      colour: new MeshBasicMaterial({ map, side: DoubleSide }),
      lit: this.own,
      clay: new MeshStandardMaterial({ color: 0xb9b6b0, roughness: 0.75, normalMap, side: DoubleSide }),
      normals: new MeshNormalMaterial({ normalMap, side: DoubleSide }),
      wireframe: new MeshBasicMaterial({ color: 0x3a86c8, wireframe: true }),
    };
    this.object.add(mesh, this.lamps);
    mesh.geometry.computeBoundingSphere();
    mesh.updateWorldMatrix(true, false);
    this.bounds = mesh.geometry.boundingSphere!.clone().applyMatrix4(mesh.matrixWorld);
  }

  /** Draw the surface in this way. */
  show(surface: Surface): void {
    this.mesh.material = this.materials[surface];
    this.lamps.visible = surface === "clay";
  }

  /** Put the material into an environment. */
  light({ map, angle }: Environment): void {
    this.own.envMap = map;
    this.own.envMapRotation.y = angle;
    this.own.needsUpdate = true;
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    for (const material of Object.values(this.materials)) material.dispose();
    for (const map of [this.own.map, this.own.normalMap, this.own.aoMap]) map?.dispose();
  }
}

/** Read the mesh, and move it to the scene's origin. Throws if the file has no mesh. */
export async function loadMesh(file: ArrayBuffer): Promise<MeshObject> {
  const loader = new GLTFLoader().register(withImages);
  const { scene } = await loader.parseAsync(file, "");
  const mesh = firstMesh(scene);
  // The node maps positions to the cameras' frame. Near the origin, they keep their precision on the GPU.
  const shift = mesh.position.clone().negate();
  const turn = mesh.quaternion.clone();
  mesh.position.set(0, 0, 0);
  return new MeshObject(mesh, { turn, shift });
}

/** Decode maps by <img>, because the loader itself fetches blobs, which the page's security policy forbids. */
function withImages(parser: GLTFParser): GLTFLoaderPlugin {
  parser.textureLoader = new TextureLoader(parser.options.manager);
  return { name: "images" };
}

function firstMesh(scene: Object3D): Mesh {
  let found: Mesh | undefined;
  scene.traverse((node) => {
    if (found === undefined && node instanceof Mesh) found = node;
  });
  if (found === undefined) throw new Error("model.glb has no mesh");
  return found;
}

function keyLight(): DirectionalLight {
  const light = new DirectionalLight(0xffffff, 1.8);
  light.position.set(0.6, 1, 0.8);
  return light;
}
