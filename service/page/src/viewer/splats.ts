// The splats of a PLY, drawn by Spark.

import { SparkRenderer, SplatFileType, SplatMesh } from "@sparkjsdev/spark";
import { Group, Vector3, type WebGLRenderer } from "three";
import type { Placement } from "./mesh";

// The most bytes of a header.
const LONGEST_HEADER = 1 << 16;

export class SplatObject {
  constructor(
    readonly object: Group,
    private readonly splats: SplatMesh,
    private readonly spark: SparkRenderer,
  ) {}

  dispose(): void {
    this.splats.dispose();
    this.spark.dispose();
  }
}

/** The splats. dirty: called when they should be drawn again, such as when they have been sorted for a new view. Throws if
 * the origin in the file is invalid. */
export async function loadSplats(
  renderer: WebGLRenderer,
  file: ArrayBuffer,
  { turn, shift }: Placement,
  dirty: () => void,
): Promise<SplatObject> {
  // Both may be millions long, but their sum is short. JavaScript's float64 keeps it precise; float32 on the GPU does not.
  const position = originOf(file).applyQuaternion(turn).add(shift);
  const spark = new SparkRenderer({ renderer, onDirty: dirty });
  const splats = new SplatMesh({ fileBytes: new Uint8Array(file), fileType: SplatFileType.PLY });
  await splats.initialized;
  splats.quaternion.copy(turn);
  splats.position.copy(position);
  const object = new Group();
  object.add(spark, splats);
  return new SplatObject(object, splats, spark);
}

/** What is added to a PLY's positions for those of the cameras' frame: the numbers of the comment `mgsr origin X Y Z`
 * in its header, zeros without one. */
function originOf(file: ArrayBuffer): Vector3 {
  const start = new TextDecoder("latin1").decode(file.slice(0, LONGEST_HEADER));
  const header = start.split("end_header", 1)[0]!;
  const text = /^comment mgsr origin (.*)$/m.exec(header)?.[1];
  if (text === undefined) return new Vector3();
  const values = text.trim().split(/\s+/).map(Number);
  if (values.length !== 3 || !values.every(Number.isFinite)) {
    throw new Error(`the splats' origin: expected three finite numbers, got "${text.slice(0, 80)}"`);
  }
  return new Vector3().fromArray(values);
}
