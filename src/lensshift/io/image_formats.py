"""All images of a burst or a result in one file: OME-TIFF for microscopes, FITS for telescopes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lensshift.core.atomic import written_whole
from lensshift.core.intrinsics import Pinhole
from lensshift.core.types import Burst, Reconstruction
from lensshift.io.fits_wcs import astropy_fits, told_wcs
from lensshift.io.image_file import FITS_SUFFIXES
from lensshift.io.picture_layers import picture_layers

if TYPE_CHECKING:
    from astropy.io.fits import Header

OME_ENDINGS = (".ome.tif", ".ome.tiff")


def is_ome(path: str | Path) -> bool:
    """Tell whether a name asks for OME-TIFF."""
    return Path(path).name.lower().endswith(OME_ENDINGS)


def is_fits(path: str | Path) -> bool:
    """Tell whether a name asks for FITS."""
    return Path(path).suffix.lower() in FITS_SUFFIXES


def _tells_pitch(value: Burst | Reconstruction) -> bool:
    return value.grid.tells_pitch(value.scale if isinstance(value, Reconstruction) else 1)


def export_ome(value: Burst | Reconstruction, path: str | Path) -> None:
    """Write all images as float32 channels of an OME-TIFF, with names, and pixel size if told."""
    import tifffile

    layers = picture_layers(value)
    stack = np.stack([one.values.astype(np.float32) for one in layers], axis=-3)
    told: dict[str, Any] = {
        "axes": "TCYX" if stack.ndim == 4 else "CYX",
        "Channel": {
            "Name": [f"{one.name} ({one.unit})" if one.unit else one.name for one in layers]
        },
    }
    if _tells_pitch(value):
        for axis, pitch_mm in zip("YX", value.grid.pitch_mm, strict=True):
            told[f"PhysicalSize{axis}"] = 1e3 * pitch_mm
            told[f"PhysicalSize{axis}Unit"] = "\u00b5m"
    with written_whole(path) as part:
        tifffile.imwrite(part, stack, ome=True, photometric="minisblack", metadata=told)


def export_fits(value: Burst | Reconstruction, path: str | Path) -> None:
    """Write all images as extensions of a FITS file, with their coordinates (WCS).

    Those of the FITS file that the frames are from, of finer pixels. Else, with a pinhole without
    distortion, angles to the right and up from the axis of the camera, by the gnomonic projection
    (CMLN-TAN, CMLT-TAN); an alternative, A, which is the only one of other cameras, gives mm on the
    sensor from the middle of the first pixel, if the pitch is told. The first row of an image is
    the first of the file. ImportError if astropy is not installed. DataError if the file cannot be
    written.
    """
    fits = astropy_fits()
    first = fits.PrimaryHDU()
    first.header["ORIGIN"] = "lensshift"
    if isinstance(value, Reconstruction):
        first.header["METHOD"] = (value.method, "of the reconstruction")
        first.header["SCALE"] = (value.scale, "pixels per pixel of a frame, along an axis")
    pages = [first]
    for one in picture_layers(value):
        values = one.values.astype(np.uint8) if one.values.dtype == np.bool_ else one.values
        page = fits.ImageHDU(values, name=one.name)
        if one.unit:
            page.header["BUNIT"] = one.unit
        _write_wcs(page.header, value)
        pages.append(page)
    with written_whole(path) as part:
        fits.HDUList(pages).writeto(part, overwrite=True, output_verify="exception")


def _write_wcs(header: Header, value: Burst | Reconstruction) -> None:
    from astropy.wcs import WCS

    def cards(kinds: tuple[str, str], unit: str, first: Any, steps: Any, which: str = " ") -> Any:
        told = WCS(naxis=2)
        told.wcs.alt = which
        told.wcs.ctype, told.wcs.cunit = kinds, (unit, unit)
        told.wcs.crpix, told.wcs.cdelt = first, steps
        return told.to_header()

    if (told := told_wcs(value)) is not None:
        header.update(told)
        return
    seen = value.intrinsics
    straight = isinstance(seen, Pinhole) and not any((seen.k1, seen.k2, seen.p1, seen.p2, seen.k3))
    if isinstance(seen, Pinhole) and straight:
        steps = np.rad2deg((1 / seen.fx_px, -1 / seen.fy_px))
        middle = (seen.cx_px + 1.0, seen.cy_px + 1.0)
        header.update(cards(("CMLN-TAN", "CMLT-TAN"), "deg", middle, steps))
    if not _tells_pitch(value):
        return
    on_sensor = (1.0, 1.0), value.grid.pitch_mm[::-1]
    header.update(cards(("X", "Y"), "mm", *on_sensor, "A" if straight else " "))
