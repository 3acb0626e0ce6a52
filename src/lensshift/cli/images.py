"""What the verbs of `evaluate` share: images with their pitch, regions, tables, figures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

from lensshift.cli.inputs import Kind, kind_of, parse_numbers, parse_pitch_mm
from lensshift.cli.session import picked
from lensshift.cli.verbs import argument, option
from lensshift.core.errors import DataError, warn_quality

if TYPE_CHECKING:
    from lensshift.core.arrays import Array
    from lensshift.core.grid import Grid
    from lensshift.core.types import Burst


Pitch = tuple[float, float]  # (row, col)
_COLOURS = (3, 4)  # numbers a pixel, of colours and of those with an opacity; no image is as narrow
_SAME_PITCH = 0.01  # as people round it; frequencies are told no better
Region = tuple[int, int, int, int]  # row start, row stop, col start, col stop
PitchOption = Annotated[
    str | None,
    typer.Option(
        "--pitch-mm",
        help="Pixel pitch of an image: one number, or row,col; default: as a TIFF of ImageJ, OME "
        "or this package tells, else lengths are in pixels.",
    ),
]
RegionOption = Annotated[
    str | None,
    typer.Option("--region", help="Region in pixels: row start,row stop,col start,col stop."),
]
KeyOption = Annotated[
    str | None,
    typer.Option("--key", help="Array of an NPZ or HDF5 file; amplitude or distance of others."),
]
FocalOption = Annotated[
    float | None,
    typer.Option("--focal-length-mm", help="Give frequencies in cycles per mrad of the scene."),
]


@dataclass(frozen=True, slots=True)
class ImageOptions:
    """The image that is measured."""

    image: Path = argument("Image, burst file or reconstruction.")
    pitch_mm: PitchOption = None
    frame: int = option(0, "Frame of IMAGE, if it holds several.", min=0)
    key: KeyOption = None


@dataclass(frozen=True, slots=True)
class PhotoOptions:
    """How the levels of a photograph become light."""

    channel: Literal["luminance", "red", "green", "blue"] | None = option(
        None, "Of a colour photograph; luminance, of a mosaic green."
    )
    gamma: float | None = option(
        None, "Light = level^gamma; 2.2 for sRGB photographs. Else linear."
    )
    oecf: Path | None = option(None, "Instead: CSV of the measured curve, level,light.")
    bayer: str | None = option(None, "Raw mosaic, as RGGB; pixels are then those of one colour.")


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """An image to be measured."""

    values: Array  # [row col], or [frame row col] with `offset_px`
    pitch_mm: tuple[float, float]  # (row, col); 1 where the pitch is not known
    has_pitch: bool  # whether it is
    valid: Array | None = None  # mask like `values`, or None
    scale: int = 1  # LR pixels are that many pixels wide
    offset_px: Array | None = None  # [frame 2] or None
    frame_px: Array | None = None  # [1 2]: how far the content of a burst's frame moved, or None
    jpeg_steps: Array | None = None  # [8 8] of a JPEG, as of `measure_edges`, or None

    @property
    def length(self) -> str:
        """Unit of lengths."""
        return "mm" if self.has_pitch else "px"


def measured_image(
    path: Path,
    pitch_mm: str | None,
    *,
    key: str | None = None,
    frame: int = 0,
    distances: bool = False,
) -> Measured:
    """Read one image [row col] and what its file says about it; `distances` if it holds some."""
    from lensshift.io import load_burst, load_reconstruction, load_window
    from lensshift.io.foreign_arrays import has_names, load_named_arrays
    from lensshift.io.image_file import load_frames

    kind, named = kind_of(path), key or ("distance" if distances else None)
    if kind is Kind.BURST:
        burst = load_burst(path)
        pitch = _pitch_of(burst.grid, 1, path, pitch_mm)
        frames = _burst_channel(burst, path, named), burst.valid
        values, valid = (_one_frame(one, path, frame) for one in frames)
        return Measured(values, *pitch, valid, frame_px=burst.offset_px[[frame]])
    if kind is not Kind.STACK:
        one = kind is Kind.RECONSTRUCTION
        result = load_reconstruction(path) if one else load_window(path, frame)
        name = named or next(iter(result.channels))
        if name not in result.channels:
            raise DataError(f"expected {' or '.join(result.channels)}, got {name!r}", source=path)
        pitch = _pitch_of(result.grid, result.scale, path, pitch_mm)
        return Measured(result.channels[name].image, *pitch, scale=result.scale)
    if has_names(path):
        usual = "distance_m" if distances else "amplitude"
        image = _named(load_named_arrays(path), path, key, usual)
    else:
        keys_of(key, path)
        image = load_frames(path)
    return Measured(_one_frame(image, path, frame), *_given_pitch(pitch_mm, path))


def _pitch_of(grid: Grid, scale: int, path: Path, pitch_mm: str | None) -> tuple[Pitch, bool]:
    """Return the pitch of a file, or the one given for it, and whether it is known."""
    if grid.tells_pitch(scale):
        if pitch_mm is not None:
            raise typer.BadParameter(f"{path} holds its own pitch; leave out --pitch-mm")
        return grid.pitch_mm, True
    return _given_pitch(pitch_mm, path)


def _given_pitch(pitch_mm: str | None, path: Path) -> tuple[Pitch, bool]:
    """Return the pitch that is given, else that of a TIFF whose writer tells it; if any is."""
    from lensshift.core.units import doubt_about_pitch
    from lensshift.io.image_file import pixel_size_mm

    if pitch_mm is None:
        told = pixel_size_mm(path)
        return told or (1.0, 1.0), told is not None
    given = parse_pitch_mm(pitch_mm)
    if doubt := doubt_about_pitch(max(given)):
        warn_quality(doubt, 2)
    return given, True


def keys_of(key: str | None, *paths: Path) -> tuple[str | None, ...]:
    """Return --key for each file in which things have names; refuse it if there is no such file."""
    from lensshift.io.foreign_arrays import has_names

    named = [has_names(path) or kind_of(path) is not Kind.STACK for path in paths]
    if key is not None and not any(named):
        files = " and ".join(map(str, paths))
        raise typer.BadParameter(f"--key: arrays have names in NPZ and HDF5 files, not in {files}")
    return tuple(key if has_names else None for has_names in named)


def measured_of(asked: ImageOptions) -> Measured:
    """Read the image that is asked for."""
    return measured_image(asked.image, asked.pitch_mm, key=asked.key, frame=asked.frame)


def measured_photograph(asked: ImageOptions, options: PhotoOptions) -> Measured:
    """Read one image; of a photograph one channel, as linear light."""
    from lensshift.evaluation.levels import bayer_frames, linear_light, one_channel
    from lensshift.io import photograph
    from lensshift.io.image_file import JPEG_SUFFIXES

    path, suffix = asked.image, asked.image.suffix.lower()
    taken = suffix in photograph.PHOTOGRAPH_SUFFIXES
    if not taken and options == PhotoOptions():
        return measured_of(asked)
    if options.gamma is not None and options.oecf is not None:
        raise typer.BadParameter("expected --gamma or --oecf, not both")
    curve = options.gamma if options.oecf is None else photograph.load_oecf(options.oecf)
    if taken:
        keys_of(asked.key, path)
        levels = photograph.load_photograph(path, frame=asked.frame)
        read = Measured(levels, *_given_pitch(asked.pitch_mm, path))
    else:
        read = measured_of(asked)
    if curve is None and suffix in JPEG_SUFFIXES:
        warn_quality(
            f"{path.name}: the levels are taken for light; those of a JPEG rarely are: --gamma 2.2",
            2,
        )
    light, channel = linear_light(read.values, curve), options.channel
    if options.bayer is not None and light.ndim > 2:
        told = "--bayer: expected a raw mosaic, one number a pixel, got a colour picture of it"
        raise DataError(told, source=path)
    if options.bayer is None:
        steps = photograph.load_jpeg_steps(path)
        if steps is not None:  # in levels of the light
            span = int(read.values.max()) - int(read.values.min())
            steps *= (light.max() - light.min()) / max(span, 1)
        return replace(read, values=one_channel(light, channel), jpeg_steps=steps)
    values, offset_px = bayer_frames(light, options.bayer, channel or "green")
    pitch = (2.0 * read.pitch_mm[0], 2.0 * read.pitch_mm[1])
    if len(values) == 1:
        return replace(read, values=values[0], pitch_mm=pitch)
    return replace(read, values=values, pitch_mm=pitch, offset_px=offset_px)


def measured_frames(path: Path, option: str, *, key: str | None = None) -> Measured:
    """Read all frames of a burst file, which an option asks for."""
    from lensshift.io import load_burst

    if kind_of(path) is not Kind.BURST:
        raise typer.BadParameter(f"{option} needs a burst file, got {path}")
    burst = load_burst(path)
    pitch = burst.grid.pitch_mm, burst.grid.tells_pitch()
    frames = _burst_channel(burst, path, key)
    return Measured(frames, *pitch, burst.valid, offset_px=burst.offset_px)


def finer(fine: Measured, coarse: Measured) -> tuple[Measured, int]:
    """Return a finer image of the same scene with the pitch that its shape tells, and the scale."""
    rows, cols = coarse.values.shape[-2:]
    scale = round(fine.values.shape[0] / rows)
    if scale < 1 or fine.values.shape != (scale * rows, scale * cols):
        raise ValueError(
            f"expected the finer image to have a whole multiple of {(rows, cols)} pixels, "
            f"got {fine.values.shape}"
        )
    pitch_mm = (coarse.pitch_mm[0] / scale, coarse.pitch_mm[1] / scale)
    expected = replace(fine, pitch_mm=pitch_mm, has_pitch=coarse.has_pitch, scale=scale)
    refuse_other_pixels(fine, expected, f"those of the coarser image by {scale}")
    return expected, scale


def refuse_other_pixels(one: Measured, other: Measured, whose: str) -> None:
    """Refuse two images that are compared but whose files tell pixels of another size."""
    pairs = zip(one.pitch_mm, other.pitch_mm, strict=True)
    apart = max(abs(ours / theirs - 1.0) for ours, theirs in pairs)
    if one.has_pitch and other.has_pitch and apart > _SAME_PITCH:
        first, second = ("{:.4g} x {:.4g} mm".format(*of.pitch_mm) for of in (one, other))
        raise ValueError(
            f"expected images of one camera and one scale, got pixels of {first} and of {second} "
            f"({whose}): are both of one burst?"
        )


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of frequency: its name, and what a frequency of the result is multiplied by."""

    name: str
    factor: float = 1.0

    def shown(self) -> dict[str, Any]:
        """Return what the figures of `lensshift.report` ask for."""
        return {"unit": self.name, "factor": self.factor}


def frequency_unit(measured: Measured, focal_length_mm: float | None) -> Unit:
    """Return the unit in which frequencies are shown."""
    if focal_length_mm is None:
        return Unit("LP/mm" if measured.has_pitch else "cycles/px")
    if not measured.has_pitch:
        raise typer.BadParameter("--focal-length-mm needs the pitch: give --pitch-mm as well")
    from lensshift.evaluation.limits import lpmm_to_cycles_per_mrad

    return Unit("cycles/mrad", float(lpmm_to_cycles_per_mrad(1.0, focal_length_mm)))


def parse_region(text: str | None) -> Region | None:
    """Return a region from "0,16,20,50"."""
    if text is None:
        return None
    expected = "a region like 0,16,20,50"
    numbers = parse_numbers(text, 4, expected)
    if not all(number.is_integer() for number in numbers):  # NaN is none
        raise typer.BadParameter(f"expected {expected}, got {text!r}")
    return cast(Region, tuple(map(int, numbers)))


def scaled(region: Region | None, scale: int) -> Region | None:
    """Return a region in pixels that are `scale` times finer."""
    return None if region is None else cast(Region, tuple(scale * end for end in region))


def slices_of(region: Region | None, shape: tuple[int, ...]) -> Any:
    """Return the slices of a region, of the whole image for None."""
    rows, cols = shape
    if region is None:
        return slice(0, rows), slice(0, cols)
    if not (0 <= region[0] < region[1] <= rows and 0 <= region[2] < region[3] <= cols):
        raise ValueError(f"expected a region within {rows} rows and {cols} columns, got {region}")
    return slice(*region[:2]), slice(*region[2:])


def interval_row(number: Any, factor: float = 1.0) -> dict[str, float]:
    """Return an interval for JSON."""
    return picked(number.scaled(factor), "value low high")


def _burst_channel(burst: Burst, path: Path, key: str | None = None) -> Array:
    """Return the frames [frame row col] of a channel, by default the amplitude."""
    channels = {"amplitude": burst.amplitude, "distance": burst.distance_m}
    frames = channels.get(key or "amplitude")
    if frames is None:
        known = " or ".join(name for name, values in channels.items() if values is not None)
        raise DataError(f"expected {known}, got {key!r}", source=path)
    return frames


def _one_frame(values: Array, path: Path, frame: int) -> Array:
    """Return one image [row col] of frames, or the image itself."""
    if values.ndim == 2 and frame == 0:
        return values
    if values.ndim != 3:
        raise DataError(f"expected [row col] and frame 0, got shape {values.shape}", source=path)
    if values.shape[2] in _COLOURS:
        told = f"expected [frame row col], got the colours of {values.shape}; save one [row col]"
        raise DataError(told, source=path)
    if not 0 <= frame < values.shape[0]:
        raise DataError(
            f"expected a frame from 0 to {values.shape[0] - 1}, got {frame}", source=path
        )
    image: Array = values[frame]
    return image


def _named(arrays: dict[str, Array], path: Path, key: str | None, usual: str) -> Array:
    """Return the array that is asked for or usual, else the only image."""
    from lensshift.io.foreign_arrays import chosen

    images = [name for name, values in arrays.items() if values.ndim in (2, 3)]
    return arrays[chosen(arrays, key, [usual] if usual in arrays else images, path)]
