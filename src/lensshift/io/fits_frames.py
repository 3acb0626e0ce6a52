"""Frames from FITS files, and what lies beside them."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError, warn_quality
from lensshift.io.fits_wcs import astropy_fits, images_of, opened_fits, quiet_astropy
from lensshift.io.reading import check_unpacked


def load_fits(path: str | Path) -> NDArray[Any]:
    """Return the frames [frame row col] of a FITS file; warn of images that nothing is done with.

    ImportError if astropy is not installed. DataError if the file is damaged or holds no stack.
    """
    fits = astropy_fits()
    with quiet_astropy():
        warnings.filterwarnings("error", ".*truncated")
        with opened_fits(Path(path)) as file:
            try:
                images, others = images_of(file)
                frames = _fits_frames(images, Path(path).stat().st_size)
                left = [page.name for page in others if _tells(page, images[0].shape)]
            except fits.VerifyError as error:  # no kin of any other
                raise DataError(f"damaged: {error!s:.200}") from error
    if left:
        warn_quality(
            f"{path}: nothing is done with the images {', '.join(left):.200}; write NaN into "
            "pixels that do not count, and name frames like the first (FRAME1, FRAME2 ...)"
        )
    return frames


def _tells(page: Any, shape: tuple[int, ...]) -> bool:
    """Tell whether an image beside the frames says more than that all their pixels are good."""
    return page.name != "DQ" or (page.shape == shape and bool(page.data.any()))


def _fits_frames(images: list[Any], file_bytes: int) -> NDArray[Any]:
    sizes = {page.shape[-2:] for page in images}
    stacks = all(len(page.shape) > 1 and one_stack(page.shape) for page in images)
    if len(sizes) != 1 or not stacks:
        shapes = ", ".join(str(page.shape) for page in images) or "none"
        raise DataError(
            f"expected images or a cube of images of one size, got {shapes}; save the frames alone"
        )
    bits = sum(abs(page.header["BITPIX"]) * math.prod(page.shape) for page in images)
    check_unpacked(bits // 8, file_bytes, "images")
    frames = [page.data.reshape(-1, *page.shape[-2:]) for page in images]
    return np.concatenate([one.astype(one.dtype.newbyteorder("=")) for one in frames])


def one_stack(shape: tuple[int, ...]) -> bool:
    """Tell whether the axes before rows and columns are those of one stack."""
    return math.prod(shape[:-2]) == max(shape[:-2], default=1)
