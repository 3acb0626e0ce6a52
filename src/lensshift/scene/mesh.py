"""Triangle meshes, from arrays or from files."""

from __future__ import annotations

import struct
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Array
from lensshift.core.errors import DataError, of_extra
from lensshift.scene.bvh import Tree, build_tree, meet_mesh
from lensshift.scene.checks import positive, table
from lensshift.scene.shapes import Rays, Shape

# What the readers of trimesh raise for files that are damaged or not what their name says.
_UNREADABLE = (
    ValueError, LookupError, TypeError, AttributeError, NameError, NotImplementedError, OSError,
    struct.error, zipfile.BadZipFile,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh(Shape):
    """Triangles, flat shaded: the normal is that of the triangle.

    Triangles without area are left out. Texture: x and y from the centre, as if projected along
    the mesh's own z.

    Parameters
    ----------
    vertices_m : [vertex 3] (x, y, z) from the centre
    triangles : [triangle 3] which vertices, from 0
    """

    vertices_m: ArrayLike
    triangles: ArrayLike

    def __post_init__(self) -> None:
        super().__post_init__()
        vertices, corners = table("vertices_m", self.vertices_m), table("triangles", self.triangles)
        for said, one in (("vertices_m [vertex 3]", vertices), ("triangles [triangle 3]", corners)):
            if one.shape[1] != 3:
                raise ValueError(f"expected {said}, got shape {one.shape}")
        triangles = corners.astype(np.int64)
        if not np.array_equal(triangles, corners):
            raise ValueError("expected whole numbers for triangles")
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise ValueError(
                f"expected vertices 0 to {len(vertices) - 1} for triangles, got "
                f"{triangles.min()} to {triangles.max()}"
            )
        triangles.flags.writeable = False
        object.__setattr__(self, "vertices_m", vertices)
        object.__setattr__(self, "triangles", triangles)
        _ = self._tree  # raises if no triangle has an area

    @cached_property
    def _tree(self) -> Tree:
        return build_tree(np.asarray(self.vertices_m)[np.asarray(self.triangles)])

    def meet(self, rays: Rays, index: int) -> None:
        """Note where the mesh is the nearest that rays have met."""
        meet_mesh(*rays.arrays(), index, *self._pose, *self._tree)

    def surface(self, point_m: Array, part: Array) -> tuple[Array, Array, Array]:
        """Return normal and texture coordinates at points of the triangles `part` of the tree."""
        normal = np.cross(self._tree.edge_1[part], self._tree.edge_2[part])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return normal, point_m[:, 0], point_m[:, 1]


def load_mesh(path: str | Path, *, unit_m: float = 1.0, **shape: Any) -> Mesh:
    """Read a mesh from any file that trimesh reads (STL, PLY, OBJ, ...).

    Parameters
    ----------
    unit_m : length of the unit of the file, 0.001 for millimetres
    shape : `centre_m`, `turn_rad`, `reflectance`, `name` of the `Mesh`

    Raises
    ------
    ImportError
        If trimesh is not installed.
    DataError
        If the file is missing, unreadable or holds no triangles.
    """
    needed = "mesh files need trimesh: python -m pip install 'lensshift[mesh]'"
    trimesh = of_extra("trimesh", needed)
    positive("unit_m", unit_m)
    if not Path(path).is_file():
        raise DataError("expected a mesh file, found none", source=path)
    try:
        loaded = trimesh.load(path, force="mesh")
        vertices_m = unit_m * np.asarray(loaded.vertices, dtype=np.float64)
        triangles = np.asarray(loaded.faces)
        if len(triangles) and np.all(np.isfinite(vertices_m)):
            Mesh(vertices_m=vertices_m, triangles=triangles, centre_m=(0.0, 0.0, 0.0))
    except _UNREADABLE as error:
        raise DataError(f"cannot read as a mesh: {error}", source=path) from error
    if not len(triangles):
        raise DataError("expected triangles with an area, found none", source=path)
    if not np.all(np.isfinite(vertices_m)):
        raise DataError("expected finite vertices, got infinity or NaN", source=path)
    return Mesh(vertices_m=vertices_m, triangles=triangles, **shape)
