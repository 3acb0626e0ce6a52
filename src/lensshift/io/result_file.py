"""Reconstructions as files, in the same container as bursts.

Schema `lensshift-reconstruction/1`, group `entry/data` and the root, dimensions (row, col) of the
HR grid. For each channel `c`, which is `amplitude` or `distance`:

    c                [row col]               status, prior_weight, noise_sigma, noise_gain,
                                             notes (JSON)
    c_std            [row col]               standard deviation, in the units of c
    c_misfit         [row col]               mean square residual in units of the noise
    c_fine           [fine_row fine_col]     smaller pixels of which c is the mean, if found so
    c_confidence     [frame lr_row lr_col]   weight of each LR pixel, 0 .. 1
    c_objective      [c_iteration]
    seen_..., c_gain, c_bias                 what predictions need, see `io.prediction_fields`
    flags            [row col]               CF flags, bit 0: flying, or in a gap of the frames
    direction        [row col xyz]           where each pixel looks, see `io.intrinsics_fields`
    attributes: pitch_mm (row, col) of the HR grid, scale, method, settings (JSON), those of a
        pinhole
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError, about, naming
from lensshift.core.grid import Grid
from lensshift.core.intrinsics import Intrinsics
from lensshift.core.types import Estimate, Reconstruction, Status
from lensshift.io import container_writer as writer
from lensshift.io.container_reader import Container, open_container
from lensshift.io.intrinsics_fields import (
    intrinsics_attributes,
    intrinsics_variables,
    read_intrinsics,
)

SCHEMA = "lensshift-reconstruction/1"
_AXES = ("row", "col")
# Channel -> unit, what it is
CHANNELS = {"amplitude": ("1", "amplitude"), "distance": ("m", "radial distance, camera frame")}
# Part of a channel -> dimensions, unit ("": that of the channel), what it is
_PARTS = {
    "std": (_AXES, "", "standard deviation of {}"),
    "misfit": (_AXES, "1", "mean square residual of {} in units of its noise"),
    "fine": (("fine_row", "fine_col"), "", "{} of smaller pixels"),
    "confidence": (("frame", "lr_row", "lr_col"), "1", "weight of the LR pixels of {}"),
}
_FLYING = np.uint8(1)
_KEPT = ("prior_weight", "noise_sigma")
_NUMBERS = (*_KEPT, "noise_gain")


def save_reconstruction(reconstruction: Reconstruction, path: str | Path) -> None:
    """Write a reconstruction to a file that appears whole or not at all.

    Raises
    ------
    DataError
        If the file cannot be written, or a field does not fit the grid or cannot be stored.
    """
    from lensshift.io.prediction_fields import prediction_variables

    variables: dict[str, writer.Variable] = {}
    for name, estimate in reconstruction.channels.items():
        variables |= _channel_variables(name, estimate)
    variables |= prediction_variables(reconstruction.channels)
    if reconstruction.flying is not None:
        flags = np.where(reconstruction.flying, _FLYING, np.uint8(0))
        variables["flags"] = writer.Variable(_AXES, flags, writer.flag_attributes("flying"))
    with naming(path):
        if not variables:
            raise DataError("there is neither an amplitude nor a distance channel")
        settings = writer.to_json(reconstruction.settings, "settings")
    grid, intrinsics = reconstruction.grid, reconstruction.intrinsics
    variables |= intrinsics_variables(intrinsics) | writer.pixel_centres(grid.shape)
    told = reconstruction.scale, reconstruction.method, settings
    attributes = picture_attributes(grid, intrinsics, *told)
    writer.write_container(writer.Content(SCHEMA, _AXES, variables, attributes), path)


def picture_attributes(
    grid: Grid, intrinsics: Intrinsics | None, scale: int, method: str, settings: str
) -> dict[str, Any]:
    """Return the attributes of a file of pictures; `settings` as JSON."""
    return {
        "pitch_mm": np.asarray(grid.pitch_mm, dtype=np.float64),
        "scale": np.int64(scale),
        "method": writer.sealed_text(method),
        "settings": writer.sealed_text(settings),
        **intrinsics_attributes(intrinsics),
    }


def load_reconstruction(path: str | Path) -> Reconstruction:
    """Read a reconstruction that `save_reconstruction` wrote.

    Raises
    ------
    DataError
        If the file is missing, damaged, of another schema, or contradicts itself; the message
        names the file and the field.
    """
    from lensshift.io.prediction_fields import with_predictions

    with open_container(path, SCHEMA) as container:
        channels = {
            name: _read_channel(container, name) for name in CHANNELS if container.has(name)
        }
        images = [channel.image for channel in channels.values()]
        if not images:
            raise DataError("the variable is missing, and so is distance", field="amplitude")
        if images[0].shape != images[-1].shape:
            problem = f"expected shape {images[0].shape} like amplitude, got {images[-1].shape}"
            raise DataError(problem, field="distance")
        scale = container.number("scale")
        if scale is None or scale < 1 or scale != int(scale):
            raise DataError(f"expected a whole number from 1, got {scale}", field="scale")
        settings = container.mapping("settings")
        channels = with_predictions(container, channels, int(scale), settings)
        flags = container.known("flags", kinds="ui", shape=images[0].shape)
        flying = None if flags is None else (flags & _FLYING) != 0
        return read_picture(container, channels, int(scale), settings, flying)


def _channel_variables(name: str, estimate: Estimate) -> dict[str, writer.Variable]:
    from lensshift.io.prediction_fields import phase_attributes

    units, label = CHANNELS[name]
    described: dict[str, Any] = {
        "status": writer.sealed_text(estimate.status.name.lower()),
        "notes": writer.sealed_text(writer.to_json(estimate.notes, f"{name}@notes")),
    }
    for number in _NUMBERS:
        value = getattr(estimate, number)
        described[number] = None if value is None else np.float64(value)
    described |= phase_attributes(estimate)
    variables = {name: writer.measured(_AXES, estimate.image, units, label, **described)}
    for part, (dims, unit, meaning) in _PARTS.items():
        if (values := getattr(estimate, part)) is not None:
            told = unit or units, meaning.format(label)
            variables[f"{name}_{part}"] = writer.measured(dims, values, *told)
    if estimate.objective:
        steps, meaning = (f"{name}_iteration",), f"objective of {label} after each iteration"
        objective = np.asarray(estimate.objective, dtype=np.float64)
        variables[f"{name}_objective"] = writer.measured(steps, objective, "1", meaning)
    return variables


def _read_channel(container: Container, name: str) -> Estimate:
    image = container.array(name)
    if image.ndim != 2 or not image.size:
        raise DataError(f"expected [row col], got shape {image.shape}", field=name)
    status = _status(container, name)
    if status is not Status.NOT_FINITE and not np.isfinite(image).any():
        raise DataError("every pixel is NaN or infinite", field=name)
    optional: dict[str, Any] = {number: container.number(number, of=name) for number in _KEPT}
    optional["notes"] = container.mapping("notes", of=name)
    for part, attribute in (("std", "uncertainty"), ("misfit", "misfit")):
        optional[attribute] = container.known(f"{name}_{part}", kinds="f", shape=image.shape)
    optional["fine"] = fine = container.known(f"{name}_fine", kinds="f")
    if fine is not None:
        smaller = fine.shape[0] // image.shape[0] if fine.ndim == 2 else 0
        if smaller < 1 or fine.shape != tuple(smaller * n for n in image.shape):
            problem = f"expected a multiple of {image.shape}, got {fine.shape}"
            raise DataError(problem, field=f"{name}_fine")
    optional["confidence"] = weights = container.known(f"{name}_confidence", kinds="f")
    if weights is not None and weights.ndim != 3:
        raise DataError("expected [frame row col]", field=f"{name}_confidence")
    objective = container.known(f"{name}_objective", kinds="uif")
    if objective is not None:
        optional["objective"] = tuple(objective.ravel().astype(float).tolist())
    return Estimate(image=image, status=status, **optional)


def _status(container: Container, name: str) -> Status:
    text = container.text("status", of=name)
    names = {status.name.lower(): status for status in Status}
    if text not in names:
        raise DataError(f"expected one of {', '.join(names)}, got {text!r}", field=f"{name}@status")
    return names[text]


def read_picture(
    container: Container,
    channels: Mapping[str, Estimate],
    scale: int,
    settings: Mapping[str, Any],
    flying: NDArray[np.bool_] | None,
) -> Reconstruction:
    """Return channels with what a file of pictures says of all of them."""
    amplitude, distance = channels.get("amplitude"), channels.get("distance")
    rows, cols = next(iter(channels.values())).image.shape
    with about("pitch_mm"):
        grid = Grid((rows, cols), container.number_pair("pitch_mm"))
    of_all = (container.text("method"), settings, flying, read_intrinsics(container))
    return Reconstruction(amplitude, distance, grid, scale, *of_all)
