"""Point clouds for other programs: PLY, PCD and NPZ.

PLY and PCD are binary and little endian; lengths are in metres, x right, y down, z forward:

    x y z                       float
    normal_x normal_y normal_z  float   (PLY: nx ny nz)
    amplitude, std              float   std of the distance along the ray
    flying                      uchar   1 where the pixel mixes two surfaces, or no frame shows it

Sources: Turk, The PLY polygon file format (1994); Point Cloud Library, The PCD file format 0.7.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.atomic import written_whole
from lensshift.core.point_cloud import PointCloud

CLOUD_SUFFIXES = (".ply", ".pcd")
_PLACES = ("x", "y", "z")
_NORMALS = {".ply": ("nx", "ny", "nz"), ".pcd": ("normal_x", "normal_y", "normal_z")}
_PLY_TYPES = {"f": "float", "u": "uchar"}


def save_point_cloud(cloud: PointCloud, path: str | Path) -> None:
    """Write a point cloud as PLY, PCD or NPZ, by the ending of the name.

    NPZ holds every field of the cloud under its name. The file appears whole or not at all.

    Raises
    ------
    ValueError
        If the ending is not supported.
    DataError
        If the file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".npz":
        write_npz(path, {name: getattr(cloud, name) for name in cloud.__dataclass_fields__})
        return
    if suffix not in CLOUD_SUFFIXES:
        name = Path(path).name
        raise ValueError(f"expected a name that ends in .ply, .pcd or .npz, got {name!r}")
    table = _table(cloud, _NORMALS[suffix])
    header = _ply_header(table) if suffix == ".ply" else _pcd_header(table)
    with written_whole(path) as temporary:
        temporary.write_bytes(header.encode("ascii") + table.tobytes())


def write_npz(path: str | Path, fields: dict[str, Any]) -> None:
    """Write those fields that are not None as arrays of an NPZ file."""
    present = {name: np.asarray(value) for name, value in fields.items() if value is not None}
    with written_whole(path) as temporary:
        np.savez_compressed(temporary, **present)  # type: ignore[arg-type]  # names are ours


def _table(cloud: PointCloud, normal_names: tuple[str, ...]) -> NDArray[Any]:
    """Return one record for each point, without gaps between the fields."""
    columns = dict(zip(_PLACES, cloud.point_m.T, strict=True))
    if cloud.normal is not None:
        columns |= dict(zip(normal_names, cloud.normal.T, strict=True))
    plain = {"amplitude": cloud.amplitude, "std": cloud.std_m, "flying": cloud.flying}
    columns |= {name: values for name, values in plain.items() if values is not None}
    kinds = [(name, "u1" if name == "flying" else "<f4") for name in columns]
    table = np.empty(len(cloud), dtype=kinds)
    for name, values in columns.items():
        table[name] = values
    return table


def _ply_header(table: NDArray[Any]) -> str:
    kinds = table.dtype
    columns = (f"property {_PLY_TYPES[kinds[name].kind]} {name}\n" for name in kinds.names or ())
    return (
        "ply\nformat binary_little_endian 1.0\n"
        "comment metres; x right, y down, z forward from the camera\n"
        f"element vertex {len(table)}\n{''.join(columns)}end_header\n"
    )


def _pcd_header(table: NDArray[Any]) -> str:
    kinds = [(name, table.dtype[name]) for name in table.dtype.names or ()]
    columns = {
        "FIELDS": [name for name, _ in kinds],
        "SIZE": [str(kind.itemsize) for _, kind in kinds],
        "TYPE": [kind.kind.upper() for _, kind in kinds],
        "COUNT": ["1" for _ in kinds],
    }
    return (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        + "".join(f"{key} {' '.join(each)}\n" for key, each in columns.items())
        + f"WIDTH {len(table)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(table)}\n"
        "DATA binary\n"
    )
