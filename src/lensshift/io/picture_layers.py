"""The images of a burst or a result by name: for OME-TIFF, FITS and napari alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.types import Burst, Reconstruction

LayerTuple = tuple[NDArray[Any], dict[str, Any], str]
UNITS = {"amplitude": "", "distance": "m"}
COLOURS = {"amplitude": "gray", "distance": "viridis"}  # of the maps that show a channel


@dataclass(frozen=True, slots=True, eq=False)
class PictureLayer:
    """One image or stack of images."""

    name: str  # "amplitude", "distance_std" and so on
    values: NDArray[Any]  # [row col] or [frame row col], real
    unit: str = ""  # of the values, "" if they have none


def picture_layers(value: Burst | Reconstruction) -> list[PictureLayer]:
    """Return the images of a burst [frame row col] or a result [row col], complex ones as modulus.

    Parameters
    ----------
    value : of a result the channels with `_std` and `_misfit`, and `flying`
    """
    if isinstance(value, Burst):
        found = [PictureLayer("amplitude", _real(value.amplitude))]
        if value.distance_m is not None:
            found.append(PictureLayer("distance", _real(value.distance_m), "m"))
        if not value.valid.all():
            found.append(PictureLayer("valid", value.valid))
        return found
    found = []
    for name, estimate in value.channels.items():
        parts = {"": estimate.image, "_std": estimate.std, "_misfit": estimate.misfit}
        for part, values in parts.items():
            if values is not None:
                unit = "" if part == "_misfit" else UNITS[name]
                found.append(PictureLayer(f"{name}{part}", _real(values), unit))
    if value.flying is not None:
        found.append(PictureLayer("flying", value.flying))
    return found


def napari_layers(value: Burst | Reconstruction) -> list[LayerTuple]:
    """Return (data, options, kind) for each image, as napari takes them.

        for data, options, kind in napari_layers(result):
            getattr(viewer, f"add_{kind}")(data, **options)

    Parameters
    ----------
    value : a burst or a result; pixels are scaled to their size in mm

    Returns
    -------
    tuples of an array, a mapping and "image" or "labels"; the errors are there but hidden
    """
    row_mm, col_mm = value.grid.pitch_mm
    layers: list[LayerTuple] = []
    for one in picture_layers(value):
        stacked = (1.0,) * (one.values.ndim - 2)
        options: dict[str, Any] = {
            "name": one.name,
            "scale": (*stacked, row_mm, col_mm),
            "metadata": {"unit": one.unit, "source": "lensshift"},
            "visible": one.name in UNITS,
        }
        if one.values.dtype == np.bool_:
            layers.append((one.values.astype(np.uint8), options, "labels"))
            continue
        colours = COLOURS.get(one.name, "magma")
        layers.append((one.values, options | {"colormap": colours}, "image"))
    return layers


def napari_reader(path: str | list[str]) -> Callable[[Any], list[LayerTuple]] | None:
    """Return what reads a burst or result file for napari, or None if this is none of ours."""
    from lensshift.io.container_reader import is_ours

    if not isinstance(path, str) or not Path(path).is_file() or not is_ours(path):
        return None
    return _read_layers


def _read_layers(path: Any) -> list[LayerTuple]:
    from lensshift.io.burst_file import load_burst
    from lensshift.io.container_reader import read_schema
    from lensshift.io.result_file import load_reconstruction

    result = read_schema(Path(path)).startswith("lensshift-reconstruction/")
    return napari_layers(load_reconstruction(path) if result else load_burst(path))


def _real(values: NDArray[Any]) -> NDArray[Any]:
    return np.abs(values) if np.iscomplexobj(values) else np.asarray(values)
