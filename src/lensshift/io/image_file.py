"""Frames from single image files: TIFF, PNG, JPEG, BMP, NPY, NPZ and FITS."""

from __future__ import annotations

import logging
import math
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError, warn_quality
from lensshift.core.units import LUMINANCE
from lensshift.io.container_reader import OTHERS, is_hdf5
from lensshift.io.fits_file import load_fits, one_stack
from lensshift.io.reading import (
    CONTAINER_SUFFIXES,
    RECORDING_SUFFIXES,
    check_held,
    check_unpacked,
    reading,
    require_file,
)

TIFF_SUFFIXES = (".tif", ".tiff")
FITS_SUFFIXES = (".fits", ".fit", ".fts")
_PACKED = (".gz", ".fz")  # of telescopes' archives, after an ending of FITS
_PACKERS = (".gz", ".bz2", ".xz", ".zst", ".zip", ".7z", ".tar", ".tgz")  # of anything else
JPEG_SUFFIXES = (".jpg", ".jpeg")
_ADVICE = "save it as greyscale of 8 or 16 bits first"
_VIDEO = "; ffmpeg -i VIDEO frames/%04d.png makes images of it"
_ARRAY = (
    "; np.save('frames.npy', np.fromfile(FILE, '<u2').reshape(frames, rows, cols)) of the right "
    "type and size makes an array of it"
)
_TABLES = (
    "; np.save('frames.npy', np.stack([np.loadtxt(file, delimiter=',') for file in FILES])) makes "
    "frames of tables of numbers; shifts are told by --offsets"
)
_MICROSCOPES = "; export it as OME-TIFF (Fiji: Bio-Formats)"
_CURES = {
    **dict.fromkeys((".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".gif"), _VIDEO),
    **dict.fromkeys((".raw", ".bin", ".dat"), _ARRAY),
    **dict.fromkeys((".csv", ".txt", ".asc"), _TABLES),
    **dict.fromkeys((".czi", ".nd2", ".lif", ".lsm", ".oif", ".vsi"), _MICROSCOPES),
    **dict.fromkeys((".heic", ".heif", ".webp", ".jp2"), f"; {_ADVICE}"),
}
_PILLOW_SUFFIXES = (".png", *JPEG_SUFFIXES, ".bmp", ".pgm")
IMAGE_SUFFIXES = (*TIFF_SUFFIXES, *_PILLOW_SUFFIXES, ".npy", *FITS_SUFFIXES)
_FORMATS = ("PNG", "TIFF", "JPEG", "BMP", "PPM")  # of Pillow
_GREY_MODES = ("L", "I;16", "I;16B", "I;16L", "I", "F")
_CHANNEL_MODES = ("LA", "RGB", "RGBA", "P", "CMYK")
_AS_RGB = ("P", "CMYK")  # P has a palette
_PIXEL_BYTES = 4  # the most that a pixel takes, of whole colours or a float
TIFFFILE_COMPRESSIONS = (1, 8, 32946)  # none and deflate; the rest is left to Pillow
_OR_FRAMES = ", or say --frame-axis last if its channels are frames"
_ORIENTATION = 0x0112  # tag of EXIF
SOFTWARE = "lensshift"  # in TIFF files of this package
_MM = {
    "nm": 1e-6, "um": 1e-3, "micron": 1e-3, "microns": 1e-3, "\u00b5m": 1e-3, "\u03bcm": 1e-3,
    "mm": 1.0, "cm": 10.0, "inch": 25.4, "in": 25.4, "m": 1e3,
}  # fmt: skip


def image_suffix(path: str | Path) -> str:
    """Return the ending that says what a file holds, in lower case; of x.fits.gz it is .fits."""
    path = Path(path)
    inner = Path(path.stem).suffix.lower()
    packed = path.suffix.lower() in _PACKED and inner in FITS_SUFFIXES
    return inner if packed else path.suffix.lower()


def load_frames(
    path: str | Path, *, key: str | None = None, colours: bool = False, alone: bool = False
) -> NDArray[Any]:
    """Read the frames of an image file, [frame row col] or, for NPY, whatever is in it.

    Integers stay integers. Colours become their luminance, with a warning, but those of the only
    page of a TIFF are refused, for they may be frames: with `colours` they are the last axis.
    `key` chooses along other axes of a TIFF, as in C=1,Z=0 (channel, depth).
    `alone`, one of several files: its colours are no frames, and what other files of a set of
    OME-TIFFs hold, which one of them names, is left out. Of a FITS file
    (.fits.gz and .fits.fz too): the extensions AMPLITUDE or SCI, else the first image and those
    named like it, if they have one size. DataError if the file is missing, damaged, of another kind
    or not greyscale. ImportError if a FITS file is asked for and astropy is not installed.
    """
    require_file(path)
    suffix = image_suffix(path)
    loaders: dict[str, Callable[[str | Path], NDArray[Any]]] = {".npy": _load_npy}
    as_told = partial(_load_tiff, key=key, colours=colours, alone=alone)
    loaders |= dict.fromkeys(TIFF_SUFFIXES, as_told)
    loaders |= dict.fromkeys(_PILLOW_SUFFIXES, _load_pillow)
    loaders |= dict.fromkeys(FITS_SUFFIXES, load_fits)
    if suffix in JPEG_SUFFIXES:
        lossy = (
            "levels of a JPEG are rounded in blocks and rarely light; take PNG or TIFF if you can"
        )
        warn_quality(lossy)
    with reading(path):
        if key is not None and suffix not in TIFF_SUFFIXES:
            raise DataError(
                "arrays have names in NPZ and HDF5, channels in TIFF files", field="key"
            )
        if suffix in loaders:
            return loaders[suffix](path)
        if suffix in CONTAINER_SUFFIXES:
            ours = is_hdf5(path)
            problem = f"not a netCDF-4/HDF5 file; {OTHERS}"
            raise DataError(
                "no image, but a netCDF file: load_burst reads bursts" if ours else problem
            )
        if suffix in RECORDING_SUFFIXES:
            raise DataError("no image, but a recording: lensshift live --replay plays it")
        cure = "; unpack it first" if suffix in _PACKERS else _CURES.get(suffix, "")
        known = ", ".join((*IMAGE_SUFFIXES, ".npz", ".mat", ".h5"))
        raise DataError(f"expected {known} or .nc, got {suffix!r:.40}{cure}")


def _load_npy(path: str | Path) -> NDArray[Any]:
    with Path(path).open("rb") as file:
        if file.read(6) != b"\x93NUMPY":
            raise DataError("not an NPY file")
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)  # refuses what is cut short
    except ValueError as error:
        if "Python objects" not in str(error):
            raise
        raise DataError("expected numbers, got Python objects; save one array of them") from error
    check_unpacked(values.nbytes, Path(path).stat().st_size, "")
    return np.array(values)


def _load_tiff(path: str | Path, *, key: str | None, colours: bool, alone: bool) -> NDArray[Any]:
    import tifffile

    with strict_tifffile(), tifffile.TiffFile(path, _multifile=not alone) as file:
        series = file.series
        if not series:
            raise DataError("damaged or cut short: there is no page in it")
        sizes = {(one.shape, one.dtype) for one in series}
        if len(sizes) > 1:
            found = ", ".join(sorted(f"{shape} {dtype}" for shape, dtype in sizes))
            raise DataError(f"expected pages of one size and type, got {found:.200}; one file each")
        page, told = file.pages.first, file.ome_metadata or ""
        cure = _OR_FRAMES if series[0].axes == "YXS" and not alone else ""
        if page.photometric not in (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB):
            raise DataError(f"expected a grey scale with black at 0; {_ADVICE}")
        if key is None and "C" in series[0].axes and "<Channel" in told:
            key = "C=0" if 'Name="amplitude"' in told else None  # beside it lie distance ...
        floats_apart = page.predictor == tifffile.PREDICTOR.FLOATINGPOINT
        if page.compression not in TIFFFILE_COMPRESSIONS or floats_apart:
            frames = _compressed(path, page, cure)
            return frames if len(series) > 1 else _along_axes(frames, series[0], key)
        size = Path(path).stat().st_size
        claimed = sum(one.nbytes for one in series)
        check_held((len(series), *series[0].shape), claimed, size, "pages")
        check_unpacked(claimed, size, "pages")
        if len(series) > 1:  # pages that were written one by one
            return np.concatenate([_pages(one, key) for one in series])
        if colours and series[0].axes == "YXS":
            return series[0].asarray()
        return _pages(series[0], key, cure)


def _compressed(path: str | Path, page: Any, cure: str) -> NDArray[Any]:
    """Return the frames of a TIFF that tifffile does not unpack by itself.

    Pillow has fewer types than files have: it gives the bits of uint32 as int32, of int8 as uint8.
    """
    from PIL import UnidentifiedImageError

    try:
        frames = _load_pillow(path, cure)
    except UnidentifiedImageError as error:
        kind = getattr(page.compression, "name", page.compression)
        problem = f"cannot unpack {page.dtype} of {kind}; save it without compression first"
        raise DataError(problem) from error
    return frames.astype(page.dtype) if frames.dtype.kind in "iu" else frames


def _along_axes(pages: NDArray[Any], series: Any, key: str | None) -> NDArray[Any]:
    """Return the frames of grey pages [page row col] along the axes that a series gives them."""
    axes = series.axes.replace("S", "")
    shape = [count for count, axis in zip(series.shape, series.axes, strict=True) if axis != "S"]
    if pages.size != math.prod(shape):
        raise DataError(f"expected pages of {tuple(shape)} ({axes}), got {pages.shape}")
    return _one_stack_of(pages.reshape(shape), axes, key)


def _pages(series: Any, key: str | None, cure: str = "") -> NDArray[Any]:
    """Return the frames [frame row col] of a series of pages."""
    if series.kind == "ome" and (missing := sum(page is None for page in series.pages)):
        raise DataError(
            f"{missing} of its {len(series.pages)} pages are in files that are not beside it"
        )
    values, axes = series.asarray(), series.axes
    if "S" in axes and not _are_frames(series, values):
        values = _grey(np.moveaxis(values, axes.index("S"), -1), cure)
        axes = axes.replace("S", "")
    return _one_stack_of(values, axes, key)


def _one_stack_of(values: NDArray[Any], axes: str, key: str | None) -> NDArray[Any]:
    """Return frames [frame row col] of axes as TZCYX, at the places that a key tells (C=1,Z=0)."""
    if values.ndim < 2:
        raise DataError(f"expected [row col] or [frame row col], got shape {values.shape}")
    others = dict(zip(axes[:-2], values.shape, strict=False))
    places = ", ".join(f"{axis}=0 to {axis}={n - 1}" for axis, n in others.items() if n > 1)
    for told in key.split(",") if key else ():
        axis, _, number = told.strip().upper().partition("=")
        if not number.isdecimal() or int(number) >= others.pop(axis, 0):
            raise DataError(
                f"expected one of {places or 'no places'}, got {told!r:.40}", field="key"
            )
        values = values.take(int(number), axis=axes.index(axis))
        axes = axes.replace(axis, "")
    if not one_stack(values.shape):
        raise DataError(
            f"expected one stack of frames, got axes {axes} {values.shape}; choose a channel or "
            f"depth by a key as C=0 (--key C=0), of {places}"
        )
    frames: NDArray[Any] = values.reshape(-1, *values.shape[-2:])
    return frames


def _are_frames(series: Any, planes: NDArray[Any]) -> bool:
    """Tell whether planes of colours are frames: tifffile stores 3 or 4 frames like that unasked.

    Planes of one grey picture are equal, with an even transparency.
    """
    if series.kind != "shaped" or series.axes != "SYX":
        return False
    return bool(np.any(planes[:3] != planes[0]) or np.any(planes[3:] != planes[3:, :1, :1]))


@contextmanager
def strict_tifffile() -> Iterator[None]:
    """Turn the errors that tifffile raises or only logs into a `DataError`.

    It logs pages that it cannot find, and leaves them out. A program may have silenced all loggers
    (`logging.disable`, or `logging.config`, which disables those that exist): this one must speak.
    """
    import tifffile

    complaints: list[str] = []
    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: complaints.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("tifffile")
    before = logger.disabled, logger.propagate
    logger.disabled, logger.propagate = False, False
    logger.isEnabledFor = lambda level: level >= logging.ERROR  # type: ignore[method-assign]
    logger.addHandler(handler)
    try:
        yield
    except tifffile.TiffFileError as error:  # older versions: not a ValueError
        complaints.append(str(error))
    except (NotImplementedError, ValueError) as error:  # as of 12 bits a pixel
        if "imagecodecs" not in str(error):
            raise
        cure = "pip install imagecodecs, or save it with 8 or 16 bits, not compressed"
        raise DataError(f"{error}: {cure}") from error
    finally:
        logger.removeHandler(handler)
        del logger.isEnabledFor
        logger.disabled, logger.propagate = before
    if complaints:
        raise DataError(f"damaged or cut short ({complaints[0]:.200})")


def pixel_size_mm(path: str | Path) -> tuple[float, float] | None:
    """Return the pixel size (row, col) in mm, or None where no file of a known origin tells it.

    The resolution of other files is that of a printer or a screen, 72 or 96 to the inch. DataError
    if what tells it is damaged.
    """
    import tifffile

    if Path(path).suffix.lower() not in TIFF_SUFFIXES:
        return None
    with reading(path), strict_tifffile(), tifffile.TiffFile(path) as file:
        if file.ome_metadata:
            found = _ome_size_mm(file.ome_metadata)
        else:
            told = (file.imagej_metadata or {}).get("unit", "")
            unit = str(told).encode().decode("unicode_escape") if "\\u" in str(told) else str(told)
            tags = file.pages.first.tags
            if tags.valueof("Software") == SOFTWARE and not unit:
                in_cm = tags.valueof("ResolutionUnit") == tifffile.RESUNIT.CENTIMETER
                unit = "cm" if in_cm else ""
            unit_mm = _MM.get(unit.strip().lower(), 0.0)
            row, col = (tags.valueof(f"{axis}Resolution") or (0, 0) for axis in "YX")
            known = unit_mm and all((*row, *col))
            found = (unit_mm * row[1] / row[0], unit_mm * col[1] / col[0]) if known else None
    return found if found and all(0 < size < 1e6 for size in found) else None


def _ome_size_mm(xml: str) -> tuple[float, float] | None:
    sizes = []
    for axis in "YX":
        size = re.search(rf'PhysicalSize{axis}="([0-9.eE+-]{{1,40}})"', xml)
        unit = re.search(rf'PhysicalSize{axis}Unit="([^"]{{1,20}})"', xml)
        factor = _MM.get(unit[1].strip().lower()) if unit else 1e-3  # micrometres by default
        if size is None or factor is None:
            return None
        sizes.append(float(size[1]) * factor)
    return sizes[0], sizes[1]


def _load_pillow(path: str | Path, cure: str = "") -> NDArray[Any]:
    pages = load_pages(path)
    return np.stack([one if one.ndim == 2 else _grey(one, cure) for one in pages])


def load_pages(path: str | Path) -> list[NDArray[Any]]:
    """Read the pages, [row col] or [row col channel], of a PNG, JPEG, BMP or TIFF by Pillow."""
    # Pillow's word for damaged tags
    with warnings.catch_warnings(action="error", category=UserWarning):
        with opened_by_pillow(path, *_FORMATS) as image:
            image.verify()  # checks the checksums, and leaves the image unusable
        with opened_by_pillow(path, *_FORMATS) as image:
            count = int(getattr(image, "n_frames", 1))
            pixels = count * image.width * image.height
            check_unpacked(_PIXEL_BYTES * pixels, Path(path).stat().st_size, "pages")
            return [_pillow_page(image, number) for number in range(count)]


@contextmanager
def opened_by_pillow(path: str | Path, *formats: str) -> Iterator[Any]:
    """Open an image of these formats; one that would fill the memory is a `DataError`."""
    from PIL import Image

    with warnings.catch_warnings(action="error", category=Image.DecompressionBombWarning):
        try:
            with Image.open(path, formats=formats) as image:
                yield image
        except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
            raise DataError(f"too large: {error}") from error


def _pillow_page(image: Any, number: int) -> NDArray[Any]:
    image.seek(number)
    if image.mode in _GREY_MODES:
        return np.asarray(image)
    if image.mode not in _CHANNEL_MODES:
        raise DataError(f"expected greyscale, got mode {image.mode!r}; {_ADVICE}")
    if any("16" in str(tile[3]) for tile in image.tile):
        raise DataError(
            "16 bits a channel with colour or transparency would lose the lower ones; "
            f"{_ADVICE}, without transparency"
        )
    return np.asarray(image.convert("RGB") if image.mode in _AS_RGB else image)


def _grey(channels: NDArray[Any], cure: str) -> NDArray[Any]:
    """Return the luminance of opaque [... channel]; of colours only if no other `cure` is told."""
    count = channels.shape[-1]
    if count in (2, 4):
        alpha = channels[..., -1]
        if np.any(alpha != alpha.flat[0]):
            raise DataError(f"expected an opaque image, got transparency; {_ADVICE}{cure}")
        channels = channels[..., :-1]
    if np.all(channels == channels[..., :1]):
        return np.ascontiguousarray(channels[..., 0])
    if count > 4 or cure:
        raise DataError(f"expected greyscale, got a colour image; {_ADVICE}{cure}")
    warn_quality(
        "the images are in colour: frames are their luminance, "
        "{} red + {} green + {} blue; for one colour save it as greyscale".format(*LUMINANCE)
    )
    light = channels @ np.array(LUMINANCE)
    whole = channels.dtype.kind in "ui"  # as those of grey images beside them
    return np.asarray((np.rint(light) if whole else light).astype(channels.dtype))


def orientation(path: str | Path) -> int:
    """Return how a photograph is turned for a viewer, from 1 (as it is) to 8, as EXIF has it."""
    if Path(path).suffix.lower() not in (".png", *JPEG_SUFFIXES):
        return 1
    try:
        with reading(path), opened_by_pillow(path, "PNG", "JPEG") as image:
            told = image.getexif().get(_ORIENTATION)
    except DataError:  # a damaged tag, of pixels that may be whole
        return 1
    return told if told in range(1, 9) else 1


def upright(image: NDArray[Any], turned: int, *, rows: int = 0) -> NDArray[Any]:
    """Return an image [row col ...], or from axis `rows` on, as a viewer shows an `orientation`."""
    if turned > 4:
        image = image.swapaxes(rows, rows + 1)
    backward = [turned in (3, 4, 7, 8), turned in (2, 3, 6, 7)]
    axes = tuple(rows + axis for axis in (0, 1) if backward[axis])
    return np.ascontiguousarray(np.flip(image, axes))
