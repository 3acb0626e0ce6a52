"""Bursts from image stacks: TIFF, PNG, JPEG, NPY, NPZ, FITS with shifts from CSV or JSON."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.burst_checks import cure_of_axes, frames_axis
from lensshift.core.errors import DataError, warn_quality
from lensshift.core.settings import parse_json
from lensshift.core.types import Burst, OffsetSource
from lensshift.io import image_file
from lensshift.io.camera_matrix import DISTORTIONS, MATRICES, pinhole_of
from lensshift.io.container_reader import is_ours
from lensshift.io.fits_file import wcs_cards
from lensshift.io.foreign_arrays import chosen, has_names, load_named_arrays
from lensshift.io.intrinsics_fields import NAMES, intrinsics_of_fields
from lensshift.io.offset_table import OffsetTable, load_offsets
from lensshift.io.reading import reading

_OF_RESULT = {"scale", "method", "settings"}  # beside a picture, which counts as a frame
_OF_TRUTH = {"sharp_amplitude", "flying_in_frames"}  # what `lensshift simulate` writes beside
FRAME_KEYS = ("amplitude", "frames", "LR")
_NUMBER = re.compile("-?[0-9]+")  # in a name
_GREATEST = 1e15  # beyond it sums of squares leave single precision
_STACKS = ("distance_m", "valid")
_PLAIN = (
    "offset_px", "offset_sigma_px", "affine", "stage_mm", "stage_commanded_mm", "time_s", "phasors",
)  # fmt: skip
_SCALARS: dict[str, Callable[[NDArray[Any]], Any]] = {
    "pitch_mm": lambda values: np.broadcast_to(values.astype(np.float64).squeeze(), (2,)),
    "modulation_hz": lambda values: values.squeeze().tolist(),  # of MATLAB, all have two axes
    "offset_source": str,
    "meta": lambda values: parse_json(str(values), field="meta"),
}


def load_image_stack(
    source: str | Path | Sequence[str | Path],
    offsets: str | Path | OffsetTable | ArrayLike | None = None,
    *,
    pitch_mm: float | tuple[float, float] | None = None,
    key: str | None = None,
    frame_axis: int | None = None,
    modulation_hz: float | Sequence[float] | None = None,
    offset_source: OffsetSource | None = None,
) -> Burst:
    """Read a burst from image files and a table of shifts.

    Parameters
    ----------
    source : a multi-page TIFF, an NPY, NPZ, FITS or HDF5 file, a folder of images (sorted by the
        numbers in their names), or the image files in order
    offsets : [frame 2] (row, col) in LR pixels, or the CSV or JSON file that holds them (see
        `load_offsets`); None takes `offset_px` of an NPZ file, or leaves them to `register`
    pitch_mm : pixel pitch, one number or (row, col); None takes `pitch_mm` of an NPZ file, the
        pixel size of a TIFF of ImageJ, OME or this package, or 1
    key : name of the array in an NPZ or HDF5 file; None looks for amplitude, frames, LR, the only
        stack, or images whose names differ by a number alone; of a TIFF of several channels or
        depths places along its axes, as C=1,Z=0
    frame_axis : axis of the frames in NPY and NPZ arrays, -1 for [row col frame]; None: the first,
        unless without offsets the last one seems to be it, which is refused
    modulation_hz : modulation frequency, or all of them
    offset_source : where the offsets come from; None: as the file says, else "planned", or
        "unknown" where there are none

    NPZ and HDF5 may also hold the other fields of `Burst` under their names. Pixels that are not
    finite are not valid.

    Raises
    ------
    DataError
        If a file is missing, damaged, not greyscale, or does not fit the others.
    """
    axis = 0 if frame_axis is None and offsets is not None else frame_axis
    fields = load_stack_fields(source, key=key, frame_axis=axis)
    fields |= _offset_fields(source, offsets, fields)
    given: dict[str, Any] = {
        "pitch_mm": pitch_mm,
        "modulation_hz": modulation_hz,
        "offset_source": offset_source,
    }
    fields |= {name: value for name, value in given.items() if value is not None}
    if frame_axis is not None and "offset_px" not in fields:  # axes that were told are no doubt
        fields["offset_px"] = np.zeros((fields["amplitude"].shape[-3], 2))
        fields.setdefault("offset_source", "unknown")
    with reading(_label(source)):
        return Burst.from_arrays(**fields)


def _label(source: str | Path | Sequence[str | Path]) -> Path:
    return Path(source) if isinstance(source, str | Path) else Path(source[0] if source else "")


def load_stack_fields(
    source: str | Path | Sequence[str | Path],
    *,
    key: str | None = None,
    frame_axis: int | None = None,
) -> dict[str, Any]:
    """Read the fields of `Burst` in image files, at least `amplitude`; see `load_image_stack`."""
    if isinstance(source, str | Path):
        path = Path(source)
        if has_names(path) and not (path.is_file() and is_ours(path)):
            return _named_fields(path, key, frame_axis)
        if not path.is_dir():
            frames = image_file.load_frames(path, key=key, colours=frame_axis == -1)
            frames = _stack(frames, frame_axis, path)
            turned = image_file.orientation(path)
            return _plain_fields(image_file.upright(frames, turned, rows=frames.ndim - 2), path)
        source = _images_in(path)
    paths = [Path(path) for path in source]
    return _plain_fields(_concatenate(paths, key), paths[0])


def _plain_fields(frames: NDArray[Any], first: Path) -> dict[str, Any]:
    """Return the frames, which of their pixels are numbers, and how large these are if told."""
    frames = _usable(frames, first)
    fields: dict[str, Any] = {"amplitude": frames}
    if frames.ndim == 3 and not np.isfinite(frames).all():
        fields["valid"] = np.isfinite(frames)
    pitch_mm = image_file.pixel_size_mm(first)
    if image_file.image_suffix(first) in image_file.FITS_SUFFIXES and (cards := wcs_cards(first)):
        fields["meta"] = {"wcs": cards}
    return fields if pitch_mm is None else fields | {"pitch_mm": pitch_mm}


def _images_in(folder: Path) -> list[Path]:
    with reading(folder):
        images = [
            path
            for path in folder.iterdir()
            if image_file.image_suffix(path) in image_file.IMAGE_SUFFIXES
            and not path.name.startswith(".")
        ]
        if not images:
            raise DataError(f"the folder holds no image ({', '.join(image_file.IMAGE_SUFFIXES)})")
        return in_order(sorted(images))


def in_order(images: Sequence[Path]) -> list[Path]:
    """Return images by the numbers in their names, or a `DataError` if they differ in kind.

    Another order than that, or than the alphabet's of shells, may have been meant: a warning.
    """
    kinds = sorted({image_file.image_suffix(path) for path in images})
    if len(kinds) > 1:
        cure = "keep those that are frames in a folder of their own"
        raise DataError(f"expected images of one kind, got {' and '.join(kinds)}; {cure}")
    common = Path(os.path.commonpath([path.absolute().parent for path in images]))
    names = {path: str(path.absolute().relative_to(common)) for path in images}
    found = sorted(images, key=lambda path: _natural(names[path]))
    if list(images) not in (found, sorted(images)):
        listed = ", ".join(names[path] for path in found)
        warn_quality(f"the images are frames in the order of the numbers in their names: {listed}")
    _warn_of_series(common.name, [names[path] for path in found])
    return found


def _kind(name: str) -> str:
    """Return a name without its numbers, which those of one kind have in common."""
    return _NUMBER.sub("#", name)


def _natural(name: str) -> list[tuple[bool, int, str]]:
    """Return what sorts names by the numbers in them: frame_2 before frame_10."""
    parts = re.findall(r"([0-9]+)|([^0-9]+)", name)
    return [(not digits, int(digits or 0), text) for digits, text in parts]


def _warn_of_series(folder: str, images: list[str]) -> None:
    """Warn of images that share their numbers, as amp_0, amp_1, depth_0 and depth_1."""
    numbers: dict[str, list[str]] = {}
    for name in images:
        numbers.setdefault(_kind(name), []).append("-".join(re.findall("[0-9]+", name)))
    first, *others = numbers.values()
    if len(first) > 1 and others and all(each == first for each in others):
        warn_quality(
            f"{folder}: all {len(images)} images are taken for frames of one kind, though "
            f"{' and '.join(numbers)} have the same numbers; if they are not (distances beside "
            "amplitudes, errors), keep each kind in a folder, or make arrays of them: "
            "Burst.from_arrays(amplitude, distance_m)"
        )


def _concatenate(paths: list[Path], key: str | None) -> NDArray[Any]:
    if not paths:
        raise DataError("expected at least one image file, got none")
    stacks = [image_file.load_frames(path, key=key, alone=True) for path in paths]
    stacks = _upright([one[np.newaxis] if one.ndim == 2 else one for one in stacks], paths)
    expected = stacks[0]
    for path, frames in zip(paths, stacks, strict=True):
        if frames.ndim != 3 or frames.shape[1:] != expected.shape[1:]:
            raise DataError(
                f"expected {expected.shape[1:]} pixels as in {paths[0].name}, got "
                f"{frames.shape[1:]}; what is no frame of the burst goes into another folder",
                source=path,
            )
        if frames.dtype != expected.dtype:
            raise DataError(
                f"expected {expected.dtype} as in {paths[0].name}, got {frames.dtype}", source=path
            )
    return np.concatenate(stacks)


def _upright(stacks: list[NDArray[Any]], paths: list[Path]) -> list[NDArray[Any]]:
    """Return photographs as a viewer shows them, all like the first one if so they are alike.

    A camera that looks down guesses how it is held, and may guess anew for each frame.
    """
    own = [image_file.orientation(path) for path in paths]

    def turned(*each: int) -> list[NDArray[Any]]:
        both = zip(stacks, each, strict=True)
        return [image_file.upright(one, told, rows=one.ndim - 2) for one, told in both]

    frames, alike = turned(*own), own[:1] * len(own)
    if own == alike or _apart(frames) <= _apart(turned(*alike)):
        return frames
    warn_quality(
        "the photographs say that they are turned differently (EXIF orientation), but are alike "
        f"as they are: all are turned like {paths[0].name}"
    )
    return turned(*alike)


def _apart(stacks: list[NDArray[Any]]) -> float:
    """Return how much images differ from the first one; infinity if their sizes do."""
    if len({one.shape[1:] for one in stacks}) > 1:
        return math.inf
    first = stacks[0][0].astype(np.float64)
    return sum(float(np.mean(np.abs(one[0] - first))) for one in stacks)


def _stack(
    values: NDArray[Any], frame_axis: int | None, path: Path, field: str = ""
) -> NDArray[Any]:
    if values.ndim == 2:
        return values[np.newaxis]
    if values.ndim == 4 and values.dtype.kind == "c":  # phasors [frequency frame row col]
        return values
    for channel in (1, -1):
        if values.ndim == 4 and values.shape[channel] == 1:
            values = values.squeeze(channel)
    if values.ndim != 3:
        problem = f"expected [frame row col], got shape {values.shape}{cure_of_axes(values.shape)}"
        raise DataError(problem, field=field, source=path)
    if frame_axis is None and frames_axis(values) == 2:
        raise DataError(
            f"the {values.shape[-1]} slices of {values.shape} along the last axis are as alike as "
            "frames: if it is [row col frame], give frame axis -1 (--frame-axis last), else 0 "
            "(first)",
            field=field,
            source=path,
        )
    return np.ascontiguousarray(np.moveaxis(values, frame_axis or 0, 0))


def _usable(frames: NDArray[Any], path: Path, field: str = "") -> NDArray[Any]:
    """Return frames of numbers that single precision can calculate with."""
    if frames.dtype.kind not in "iufc":
        raise DataError(f"expected numbers, got dtype {frames.dtype}", field=field, source=path)
    if not frames.size:
        raise DataError(f"holds no pixel, shape {frames.shape}", field=field, source=path)
    if frames.dtype == np.float16:  # of which neither the solver nor netCDF knows
        frames = frames.astype(np.float32)
    largest = np.abs(frames[np.isfinite(frames)]).max(initial=0) if frames.dtype.kind in "fc" else 0
    if largest > _GREATEST:
        raise DataError(
            f"expected values up to {_GREATEST:g}, got {largest:.3g}; write NaN where nothing was "
            "measured, or scale the values",
            field=field,
            source=path,
        )
    return frames


def _named_fields(path: Path, key: str | None, frame_axis: int | None) -> dict[str, Any]:
    arrays = load_named_arrays(path, (*_PLAIN, *_SCALARS, *NAMES))
    if arrays.keys() >= _OF_TRUTH:
        problem = "holds the truth of a simulation, no frames; expected the burst beside it"
        raise DataError(problem, field="key", source=path)
    if key is None:
        arrays = _joined(arrays)
    name = _frames_name(path, arrays, key)
    if frame_axis is None and "offset_px" in arrays:
        frame_axis = 0
    frames = _usable(_stack(arrays[name], frame_axis, path, name), path, name)
    fields: dict[str, Any] = {"amplitude": frames}
    for stack in _STACKS:
        if stack in arrays and stack != name:
            fields[stack] = _stack(arrays[stack], frame_axis, path, stack)
    _mark_unmeasured(fields)
    _warn_of_unread(path, arrays, name, key)
    told = (one for one in _PLAIN if one in arrays and one != name)  # phasors are frames, too
    fields |= {plain: arrays[plain] for plain in told}
    if "time_s" in fields:  # of MATLAB, all have two axes
        fields["time_s"] = np.ravel(fields["time_s"])
    for scalar, convert in _SCALARS.items():
        if scalar in arrays:
            with reading(path, scalar):
                fields[scalar] = convert(arrays[scalar])
    with reading(path):
        intrinsics = intrinsics_of_fields({one: arrays[one] for one in NAMES if one in arrays})
        intrinsics = intrinsics or pinhole_of(arrays)
    return fields if intrinsics is None else fields | {"intrinsics": intrinsics}


def _joined(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return arrays [row col] whose names differ by a number alone as the frames that they are."""
    images = [one for one, v in arrays.items() if v.ndim == 2 and one not in _PLAIN]
    kinds = {(_kind(one), arrays[one].shape, arrays[one].dtype) for one in images}
    if len(images) < 2 or len(kinds) > 1 or any(v.ndim > 2 for v in arrays.values()):
        return arrays
    others = {one: v for one, v in arrays.items() if one not in images}
    return others | {FRAME_KEYS[1]: np.stack([arrays[one] for one in sorted(images, key=_natural)])}


def _warn_of_unread(path: Path, arrays: Mapping[str, Any], name: str, key: str | None) -> None:
    """Warn of what nothing is done with; beside frames that a key chose, stacks may be others."""
    if arrays.keys() >= _OF_RESULT:
        return
    known = {name, *_STACKS, *_PLAIN, *_SCALARS, *NAMES, "flying", "truth"}  # of simulations
    known |= {*MATRICES, *DISTORTIONS} if pinhole_of(arrays) else set()
    shape = arrays[name].shape
    left = [one for one, v in arrays.items() if key is None or v.ndim < 3 or v.shape == shape]
    if unread := [one for one in left if one not in known]:
        warn_quality(
            f"{path}: nothing is done with {', '.join(unread):.300}; distances are read from "
            "distance_m, in metres, which pixels count from valid, shifts from offset_px, where "
            "pixels look from focal_px and centre_px (row, col), and the other fields of Burst by "
            "their names",
            4,
        )


def _mark_unmeasured(fields: dict[str, Any]) -> None:
    """Mark pixels whose amplitude or distance is no number as not valid."""
    shape = fields["amplitude"].shape
    stacks = [fields[one] for one in ("amplitude", "distance_m") if one in fields]
    finite = [np.isfinite(one) for one in stacks if one.shape == shape and one.dtype.kind in "fc"]
    measured = np.logical_and.reduce(finite) if finite else np.True_
    valid = fields.get("valid", np.ones(shape, np.bool_))
    if valid.shape == (1, *shape[1:]):  # of the sensor
        valid = np.broadcast_to(valid, shape)
    if len(shape) == 3 and valid.shape == shape and measured.any() and not measured.all():
        fields["valid"] = np.where(measured, valid, False)


def _frames_name(path: Path, arrays: dict[str, NDArray[Any]], key: str | None) -> str:
    others = (*_STACKS, "affine", *NAMES)
    stacks = [name for name, v in arrays.items() if v.ndim in (3, 4) and name not in others]
    known = [name for name in FRAME_KEYS if name in arrays]
    if key is None and not known and len(stacks) == 4 and len(set(map(_kind, stacks))) == 1:
        problem = (
            f"expected frames, got {', '.join(stacks)}{cure_of_axes((4, *arrays[stacks[0]].shape))}"
        )
        raise DataError(problem, field="key", source=path)
    return chosen(arrays, key, known[:1] or stacks, path)


def _offset_fields(
    source: str | Path | Sequence[str | Path],
    offsets: str | Path | OffsetTable | ArrayLike | None,
    fields: dict[str, Any],
) -> dict[str, Any]:
    count = int(fields["amplitude"].shape[-3])
    if offsets is None:
        return {}
    named = offsets if isinstance(offsets, str | Path) else _label(source)
    table = load_offsets(offsets) if isinstance(offsets, str | Path) else offsets
    if not isinstance(table, OffsetTable):
        table = OffsetTable(np.asarray(table))
    shape = table.offset_px.shape
    if shape != (count, 2):
        problem = f"expected shape {(count, 2)} for {count} frames, got {shape}"
        an_array = _label(source).suffix.lower() in (".npy", ".npz")
        if an_array and len(shape) == 2 and shape[0] == fields["amplitude"].shape[-1]:
            problem += "; if the array is [row col frame], set the frame axis to -1"
        raise DataError(problem, field="offset_px", source=named)
    found: dict[str, Any] = {"offset_px": table.offset_px, "offset_source": table.offset_source}
    return found | {"offset_sigma_px": table.offset_sigma_px}
