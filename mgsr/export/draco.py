"""Compression of triangle meshes by Draco, for glTF's extension KHR_draco_mesh_compression."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from mgsr.errors import MgsrError
from mgsr.geometry.mesh import Mesh

# Bits of quantisation; 14 bits are half a texel of a map with 8192 texels a side.
POSITION_BITS, NORMAL_BITS, UV_BITS = 14, 10, 14
LEVEL = 7  # of compression, 0..10, as in the tools of glTF
_NAMES = {0: "POSITION", 1: "NORMAL", 3: "TEXCOORD_0"}  # Draco's attribute types


@dataclass(frozen=True)
class DracoMesh:
    """A compressed mesh.

    data: Draco's bytes. ids: Draco's identifier of each attribute, by glTF's names. decoded: the attributes [V,n]
    float32 that a reader decodes, by the same names. faces: the number of faces that a reader decodes; faces without
    area are dropped.
    """

    data: bytes
    ids: Mapping[str, int]
    decoded: Mapping[str, np.ndarray]
    faces: int


def require_draco() -> None:
    """Check that the optional package DracoPy is installed. Raises MgsrError if it is not."""
    if find_spec("DracoPy") is None:
        raise MgsrError("output.draco: compressing the model needs the package DracoPy: pip install 'mgsr[draco]'")


def compress(mesh: Mesh, normals: np.ndarray, uvs: np.ndarray) -> DracoMesh:
    """Compress a mesh.

    normals [V,3]: unit. uvs [V,2]: 0..1.

    Raises MgsrError if DracoPy is not installed.
    """
    require_draco()
    import DracoPy  # imported here, because the package is optional

    data: bytes = DracoPy.encode(
        mesh.vertices.astype(np.float32),
        mesh.faces.astype(np.uint32),
        quantization_bits=POSITION_BITS,
        compression_level=LEVEL,
        normals=normals.astype(np.float64),
        normal_quantization_bits=NORMAL_BITS,
        tex_coord=uvs.astype(np.float64),
        tex_coord_quantization_bits=UV_BITS,
    )
    # Readers need the counts and bounds of what they will decode.
    found = DracoPy.decode(data)
    named = {_NAMES[each["attribute_type"]]: each for each in found.attributes}
    decoded = {name: np.asarray(each["data"], np.float32) for name, each in named.items()}
    return DracoMesh(data, {name: each["unique_id"] for name, each in named.items()}, decoded, len(found.faces))
