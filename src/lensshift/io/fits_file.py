"""FITS: frames from its files, and where on the sky, or on the sensor, their pixels lie."""

from __future__ import annotations

import gzip
import logging
import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from lensshift.core.errors import DataError, of_extra, warn_quality
from lensshift.core.grid import lr_to_hr
from lensshift.core.types import Burst, Reconstruction
from lensshift.io.reading import check_unpacked

if TYPE_CHECKING:
    from astropy.io.fits import Header

_GZIP, _PART_BYTES = b"\x1f\x8b", 2**20
_USED = ("AMPLITUDE", "SCI")  # extensions beside which others lie that are no frames


def astropy_fits() -> Any:
    """Return `astropy.io.fits`; an ImportError says what to install."""
    return of_extra("astropy.io.fits", "FITS needs astropy: pip install 'lensshift[fits]'")


@contextmanager
def quiet_astropy() -> Iterator[None]:
    """Keep astropy from speaking of cards, by warnings or (of SIP) on stdout, where JSON may go."""
    logger = logging.getLogger("astropy")
    with warnings.catch_warnings(action="ignore"):
        before = logger.disabled
        logger.disabled = True
        try:
            yield
        finally:
            logger.disabled = before


@contextmanager
def opened_fits(path: Path) -> Iterator[Any]:
    """Open a FITS file; one that gzip has packed is unpacked to no more than a file may take."""
    fits = astropy_fits()
    with path.open("rb") as raw:  # its own astropy may leave open
        packed = raw.read(len(_GZIP)) == _GZIP
        raw.seek(0)
        with fits.open(_unpacked(raw, path.stat().st_size) if packed else raw) as pages:
            yield pages


def _unpacked(raw: BinaryIO, file_bytes: int) -> BytesIO:
    whole = BytesIO()
    with gzip.open(raw) as file:
        while part := file.read(_PART_BYTES):
            whole.write(part)
            check_unpacked(whole.tell(), file_bytes, "images")
    whole.seek(0)
    return whole


def images_of(pages: Any) -> tuple[list[Any], list[Any]]:
    """Return the pages of a FITS file that are frames, and other images that may say more of them.

    Frames are those named AMPLITUDE or SCI, else the first image and those that are named like it,
    but for numbers: masks, errors and weights beside them have names of their own (of CCDData
    MASK and UNCERT, of others VAR, WEIGHT, IVAR, STAT, DQ ...).
    """
    images = [page for page in pages if page.is_image and page.shape]
    for name in _USED:
        if used := [page for page in images if page.name == name]:
            return used, [page for page in images if page.name == "DQ"]
    roles = ["" if page.name == "PRIMARY" else page.name.strip("0123456789_- ") for page in images]
    alike = [role == roles[0] for role in roles]
    frames = [page for page, like in zip(images, alike, strict=True) if like]
    others = [page for page, like in zip(images, alike, strict=True) if not like]
    return frames, others


def wcs_cards(path: Path) -> dict[str, Any]:
    """Return the world coordinates of the first frame of a FITS file, by card; empty if none."""
    from astropy.io import fits
    from astropy.wcs import WCS

    with quiet_astropy(), opened_fits(path) as pages:
        try:
            header = images_of(pages)[0][0].header
            told = str(header.get("CTYPE1", "")).strip()
            return dict(WCS(header, naxis=2).to_header(relax=True)) if told else {}
        except (ValueError, LookupError, TypeError, fits.VerifyError) as error:
            problem = f"its world coordinates are left out: {error!s:.100}"
    warn_quality(f"{path}: {problem}")
    return {}


def told_wcs(value: Burst | Reconstruction) -> Header | None:
    """Return the world coordinates of the images, if the FITS file that they are from had some.

    A pixel of the first frame is where its content lies; of a result, at offset (0, 0).
    """
    if isinstance(value, Burst):
        return _moved(value.meta.get("wcs"), (0.0, 0.0), 1)
    told = value.settings.get("wcs") or {}
    return _moved(told.get("cards"), told.get("offset_px", (0.0, 0.0)), value.scale)


def _moved(cards: Mapping[str, Any] | None, offset_px: Any, scale: int) -> Header | None:
    """Return the coordinates of pixels `scale` times finer, where the offset is undone."""
    if not cards:
        return None
    from astropy.io.fits import Header
    from astropy.wcs import WCS, Sip

    with quiet_astropy():
        told = WCS(Header(cards.items()))
        first = told.wcs.crpix - 1.0 - np.asarray(offset_px)[::-1]
        told.wcs.crpix = lr_to_hr(first, scale) + 1.0
        step = "cd" if told.wcs.has_cd() else "cdelt"
        if str(cards.get("CTYPE1")).endswith("TPV"):  # whose polynomials are between PC and CDELT
            step = "pc"
        setattr(told.wcs, step, getattr(told.wcs, step) / scale)
        if told.sip is not None:  # polynomials of the distance from there
            bent = [getattr(told.sip, name) for name in ("a", "b", "ap", "bp")]
            bent = [one if one is None else one * float(scale) ** (1 - np.indices(one.shape).sum(0))
                    for one in bent]  # fmt: skip
            told.sip = Sip(*bent, told.wcs.crpix)
        return told.to_header(relax=True)


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
