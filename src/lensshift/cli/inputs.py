"""What the verbs read: burst files, reconstructions and image stacks, told apart by content."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from lensshift.cli.session import picked
from lensshift.cli.verbs import option
from lensshift.core.errors import DataError, naming

if TYPE_CHECKING:
    from lensshift.core.types import Burst


BurstArgument = Annotated[
    list[Path],
    typer.Argument(
        help="A burst file, or an image stack (TIFF, NPY, NPZ, MAT, FITS, HDF5, folder of images), "
        "or several images, which count by the numbers in their names.",
        metavar="BURST",
    ),
]
PatternOption = Annotated[
    Literal["square", "3x3", "4x4", "still"],  # of `lensshift.core.pattern`
    typer.Option("--pattern", help="Where the image is sent."),
]
FRAME_AXES = {None: None, "first": 0, "last": -1}


@dataclass(frozen=True, slots=True)
class StackOptions:
    """What an image stack does not say itself."""

    offsets: Path | None = option(
        None, "Shifts of an image stack: CSV (row,col) or JSON, in LR px."
    )
    pitch_mm: str | None = option(None, "Pixel pitch of an image stack: one number, or row,col.")
    key: str | None = option(
        None, "Name of the frames in an NPZ or HDF5 file; of a TIFF, C=1 (channel), Z=0 (depth)."
    )
    frame_axis: Literal["first", "last"] | None = option(
        None,
        "Where the frames lie in an array or a TIFF; default: first, if that can be.",
    )
    modulation_hz: list[float] | None = option(
        None, "Modulation frequency of frames that do not tell it; again for each further one."
    )


class Kind(Enum):
    """What a file holds."""

    BURST = "burst"
    RECONSTRUCTION = "reconstruction"
    SEQUENCE = "sequence"
    STACK = "image stack"


def kind_of(path: Path) -> Kind:
    """Tell what a file or folder holds."""
    from lensshift.io.capture_file import is_capture
    from lensshift.io.container_reader import is_ours, read_schema

    if is_capture(path):
        return Kind.BURST
    if path.is_dir() or not is_ours(path):
        return Kind.STACK
    schema = read_schema(path)
    for kind in (Kind.BURST, Kind.RECONSTRUCTION, Kind.SEQUENCE):
        if schema.startswith(f"lensshift-{kind.value}/"):
            return kind
    raise DataError(f"expected a burst or a reconstruction, got {schema!r:.80}", source=path)


def source_of(given: Sequence[Path]) -> Path:
    """Return the name of what is read: the only path, or the folder of several images."""
    folder = given[0].parent
    return given[0] if len(given) == 1 else folder if folder.name else folder.absolute()


def several(given: Sequence[Path]) -> list[Path]:
    """Return images by the numbers in their names; a usage error if one of them is no image."""
    from lensshift.io.foreign_arrays import has_names
    from lensshift.io.image_stack import in_order

    for path in given:
        if path.is_dir() or has_names(path):
            raise typer.BadParameter(
                f"{path}: several files are the images of one burst; a folder, a burst, a result "
                "or arrays by name are given alone"
            )
    return in_order(given)


def load_input_burst(given: Sequence[Path], options: StackOptions) -> Burst:
    """Read a burst file, an image stack or images, of which nobody may have told the offsets."""
    from lensshift.io import load_burst, load_image_stack

    pitch_mm = None if options.pitch_mm is None else parse_pitch_mm(options.pitch_mm)
    path = given[0]
    kind = kind_of(path) if len(given) == 1 else Kind.STACK
    if kind is Kind.BURST:
        return _told_more(load_burst(path), path, options)
    if kind is not Kind.STACK:
        raise DataError(f"expected a burst, got a {kind.value}", source=path)
    told: dict[str, Any] = {"pitch_mm": pitch_mm, "frame_axis": FRAME_AXES[options.frame_axis]}
    told |= picked(options, "key modulation_hz")
    images = path if len(given) == 1 else several(given)
    return load_image_stack(images, options.offsets, **told)


def _told_more(burst: Burst, path: Path, options: StackOptions) -> Burst:
    """Return the burst of a file with the modulation that the file does not tell."""
    if replace(options, modulation_hz=None) != StackOptions():
        raise typer.BadParameter(
            f"{path} is a burst file and says itself where its frames lie; leave out --offsets, "
            "--pitch-mm, --key and --frame-axis"
        )
    if options.modulation_hz is None:
        return burst
    if burst.modulation_hz is not None:
        known = ", ".join(f"{hz:g}" for hz in burst.frequencies_hz)
        raise typer.BadParameter(
            f"{path} says itself that its light was modulated at {known} Hz; leave out "
            "--modulation-hz"
        )
    with naming(path):
        return replace(burst, modulation_hz=tuple(options.modulation_hz))


def parse_pitch_mm(text: str) -> tuple[float, float]:
    """Return the pitch (row, col) from "0.1" or "0.1,0.2"."""
    expected = "a pitch like 0.1 or 0.1,0.2"
    numbers = parse_numbers(text, 1 if "," not in text else 2, expected)
    if not all(0.0 < number < math.inf for number in numbers):
        raise typer.BadParameter(f"expected {expected}, got {text!r}")
    return numbers[0], numbers[-1]


def parse_numbers(text: str, count: int, expected: str, *, ends: bool = True) -> tuple[float, ...]:
    """Return finite numbers separated by commas; the last may be no end, inf."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise typer.BadParameter(f"expected {expected}, got {text!r}") from error
    finite = all(map(math.isfinite, numbers)) or (not ends and numbers[-1] == math.inf)
    if len(numbers) != count or not finite:
        raise typer.BadParameter(f"expected {expected}, got {text!r}")
    return numbers


def refuse_overwriting(inputs: Iterable[Path | None], outputs: Iterable[Path]) -> None:
    """Raise a usage error if an output is an input (or in an input folder), or comes twice."""
    given = (path for path in inputs if path is not None)
    files = (file for path in given for file in (path.iterdir() if path.is_dir() else (path,)))
    taken = {file.resolve(): "would overwrite the input" for file in files}
    for output in outputs:
        place = output.resolve()
        if place in taken:
            raise typer.BadParameter(f"{output} {taken[place]}; choose another name")
        taken[place] = "is written twice"


def check_files(inputs: Iterable[Path | None], outputs: Sequence[Path]) -> None:
    """Complain before the work about files that would be overwritten or cannot be written."""
    from lensshift.core.atomic import writable_target

    refuse_overwriting(inputs, outputs)
    for path in outputs:
        writable_target(path)


def check_netcdf(path: Path, what: str, cure: str = "") -> None:
    """Refuse a name that promises another format than the one that is written."""
    if path.is_dir():
        raise typer.BadParameter(f"{path} is a folder; expected the name of {what}, a .nc file")
    if path.suffix.lower() != ".nc":
        raise typer.BadParameter(f"{path}: {what} is a netCDF file (.nc){cure}")


def beside(source: Path, ending: str) -> Path:
    """Return a name beside a file or folder: its own with another ending."""
    whole = source.resolve()
    name = whole.name if whole.is_dir() else whole.stem
    return (source.parent if source.name else whole.parent) / f"{name}{ending}"
