// The splats of a PLY, drawn by Spark.

import { SparkRenderer, SplatFileType, SplatMesh } from "@sparkjsdev/spark";
import { Group, type WebGLRenderer } from "three";
import type { Placement } from "./mesh";

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

/** The splats. dirty: called when they should be drawn again, such as when they have been sorted for a new view. */
export async function loadSplats(
  renderer: WebGLRenderer,
  file: ArrayBuffer,
  { turn, shift }: Placement,
  dirty: () => void,
): Promise<SplatObject> {
  const spark = new SparkRenderer({ renderer, onDirty: dirty });
  const splats = new SplatMesh({ fileBytes: new Uint8Array(file), fileType: SplatFileType.PLY });
  await splats.initialized;
  splats.quaternion.copy(turn);
  splats.position.copy(shift);
  const object = new Group();
  object.add(spark, splats);
  return new SplatObject(object, splats, spark);
}
