"""Frames from single image files: TIFF, PNG, NPY and NPZ."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError
from lensshift.io.reading import check_held, check_unpacked, reading, require_file, unpacked_bytes

TIFF_SUFFIXES = (".tif", ".tiff")
IMAGE_SUFFIXES = (*TIFF_SUFFIXES, ".png", ".npy")
_GREY_MODES = ("L", "I;16", "I;16B", "I;16L", "I", "F")
_CHANNEL_MODES = ("LA", "RGB", "RGBA")
_PIXEL_BYTES = 4  # the most that a pixel takes, of whole colours or a float
TIFFFILE_COMPRESSIONS = (1, 8, 32946)  # none and deflate; the rest is left to Pillow
_ADVICE = "save it as greyscale of 8 or 16 bits first"


def load_frames(path: str | Path) -> NDArray[Any]:
    """Read the frames of an image file, [frame row col] or, for NPY, whatever is in it.

    Integers stay integers. Colour images are taken only if their channels are equal.

    Raises
    ------
    DataError
        If the file is missing, damaged, of another kind or not greyscale.
    """
    require_file(path)
    suffix = Path(path).suffix.lower()
    with reading(path):
        if suffix in TIFF_SUFFIXES:
            return _load_tiff(path)
        if suffix == ".png":
            return _load_pillow(path)
        if suffix == ".npy":
            return _load_npy(path)
        raise DataError(f"expected {', '.join(IMAGE_SUFFIXES)} or .npz, got {suffix!r:.40}")


def load_named_arrays(path: str | Path) -> dict[str, NDArray[Any]]:
    """Read all arrays of an NPZ file; pickled objects are refused.

    Raises
    ------
    DataError
        If the file is missing, damaged or holds Python objects.
    """
    require_file(path)
    with reading(path):
        _check_signature(path, b"PK", "an NPZ file")
        with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as archive:
            check_unpacked(unpacked_bytes(archive), Path(path).stat().st_size, "")
            return {name: _without_pickles(archive, name) for name in archive.files}


def _without_pickles(archive: Mapping[str, NDArray[Any]], name: str) -> NDArray[Any]:
    with reading("", name):
        values = archive[name]
        if not isinstance(values, np.ndarray):
            raise DataError("expected an array", field=name)
        return values


def _load_npy(path: str | Path) -> NDArray[Any]:
    _check_signature(path, b"\x93NUMPY", "an NPY file")
    values = np.load(path, mmap_mode="r", allow_pickle=False)  # refuses what is cut short
    check_unpacked(values.nbytes, Path(path).stat().st_size, "")
    return np.array(values)


def _check_signature(path: str | Path, signature: bytes, kind: str) -> None:
    with Path(path).open("rb") as file:
        if file.read(len(signature)) != signature:
            raise DataError(f"not {kind}")


def _load_tiff(path: str | Path) -> NDArray[Any]:
    import tifffile

    with strict_tifffile(), tifffile.TiffFile(path) as file:
        series = file.series
        if len(series) != 1:
            raise DataError(f"expected pages of one size, got {len(series)} kinds of pages")
        page = file.pages.first
        if page.photometric not in (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB):
            raise DataError(f"expected a grey scale with black at 0; {_ADVICE}")
        if page.compression not in TIFFFILE_COMPRESSIONS:
            return _load_pillow(path)
        size = Path(path).stat().st_size
        check_held(series[0].shape, series[0].nbytes, size, "pages")
        check_unpacked(series[0].nbytes, size, "pages")
        values = series[0].asarray()
        if "S" in series[0].axes and not _are_frames(series[0], values):
            values = _grey(np.moveaxis(values, series[0].axes.index("S"), -1))
    if values.ndim < 2:
        raise DataError(f"expected [row col] or [frame row col], got shape {values.shape}")
    frames = values.reshape(-1, *values.shape[-2:])
    if values.ndim > 3 and frames.shape[0] != max(values.shape[:-2]):
        raise DataError(f"expected one stack of frames, got axes {series[0].axes} {values.shape}")
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

    It logs pages that it cannot find, and leaves them out.
    """
    import tifffile

    complaints: list[str] = []
    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: complaints.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("tifffile")
    logger.addHandler(handler)
    try:
        yield
    except tifffile.TiffFileError as error:  # older versions: not a ValueError
        complaints.append(str(error))
    finally:
        logger.removeHandler(handler)
    if complaints:
        raise DataError(f"damaged or cut short ({complaints[0]:.200})")


def _load_pillow(path: str | Path) -> NDArray[Any]:
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        warnings.simplefilter("error", UserWarning)  # Pillow's word for damaged tags
        try:
            with Image.open(path, formats=("PNG", "TIFF")) as image:
                image.verify()  # checks the checksums, and leaves the image unusable
            with Image.open(path, formats=("PNG", "TIFF")) as image:
                pixels = _frame_count(image) * image.width * image.height
                check_unpacked(_PIXEL_BYTES * pixels, Path(path).stat().st_size, "pages")
                return np.stack([_pillow_frame(image, n) for n in range(_frame_count(image))])
        except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
            raise DataError(f"too large: {error}") from error


def _frame_count(image: Any) -> int:
    return int(getattr(image, "n_frames", 1))


def _pillow_frame(image: Any, number: int) -> NDArray[Any]:
    image.seek(number)
    if image.mode in _GREY_MODES:
        return np.asarray(image)
    if image.mode not in _CHANNEL_MODES:
        raise DataError(f"expected greyscale, got mode {image.mode!r}; {_ADVICE}")
    if any("16" in str(tile[3]) for tile in image.tile):
        raise DataError(f"colour of 16 bits a channel would lose its lower bits; {_ADVICE}")
    return _grey(np.asarray(image))


def _grey(channels: NDArray[Any]) -> NDArray[Any]:
    """Return the grey image of [... channel] whose colours are equal and opaque."""
    count = channels.shape[-1]
    if count in (2, 4):
        alpha = channels[..., -1]
        if np.any(alpha != alpha.flat[0]):
            raise DataError(f"expected an opaque image, got transparency; {_ADVICE}")
        channels = channels[..., :-1]
    if count > 4 or np.any(channels != channels[..., :1]):
        raise DataError(f"expected greyscale, got a colour image; {_ADVICE}")
    return np.ascontiguousarray(channels[..., 0])
