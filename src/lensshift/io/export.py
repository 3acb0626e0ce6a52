"""Images and points for other programs: TIFF, OME-TIFF, FITS, PNG, NPZ, PLY and PCD."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.atomic import written_whole
from lensshift.core.intrinsics import Pinhole, points_m
from lensshift.core.types import FRAME_FIELDS, Burst, Reconstruction
from lensshift.io.container_writer import to_json
from lensshift.io.fits_file import astropy_fits, told_wcs
from lensshift.io.image_file import FITS_SUFFIXES, SOFTWARE, TIFF_SUFFIXES
from lensshift.io.intrinsics_fields import intrinsics_fields
from lensshift.io.picture_layers import PictureLayer, picture_layers
from lensshift.io.point_cloud_file import CLOUD_SUFFIXES, save_point_cloud, write_npz

if TYPE_CHECKING:
    from astropy.io.fits import Header

OME_ENDINGS = (".ome.tif", ".ome.tiff")
_BURST_ARRAYS = ("amplitude", "offset_px", "modulation_hz", *FRAME_FIELDS)


def export_image(
    image: ArrayLike,
    path: str | Path,
    *,
    bits: Literal[8, 16] = 8,
    black: float | None = None,
    white: float | None = None,
    pitch_mm: tuple[float, float] | None = None,
) -> tuple[float, float]:
    """Write an image as TIFF or PNG, by the ending of the name.

        PNG:  grey = round( (2^bits - 1) * clip((value - black) / (white - black), 0, 1) )

    TIFF keeps the numbers: 8- and 16-bit integers as they are, everything else as float32. A
    stack [frame row col] becomes pages. NaN stays NaN in TIFF and is black in PNG.

    Parameters
    ----------
    image : [row col], or [frame row col] for TIFF; real
    bits : of a PNG pixel
    black, white : values that become black and white in PNG; None: smallest, largest finite value
    pitch_mm : pixel size (row, col) for the tags of a TIFF, or None

    Returns
    -------
    The values that became black and white (PNG) or the smallest and largest value (TIFF). PNG
    files carry them as text, too.

    Raises
    ------
    ValueError
        If the image is complex, has the wrong shape, or the ending or a setting is not supported.
    DataError
        If the file cannot be written.
    """
    values = _as_real(image)
    suffix = Path(path).suffix.lower()
    if suffix in TIFF_SUFFIXES:
        return _write_tiff(values, path, pitch_mm)
    if suffix != ".png":
        raise ValueError(f"expected a name that ends in .tif or .png, got {Path(path).name!r}")
    if values.ndim != 2:
        raise ValueError(f"expected [row col] for PNG, got shape {values.shape}")
    from PIL import Image, PngImagePlugin

    low, high = finite_range(values)
    low, high = low if black is None else float(black), high if white is None else float(white)
    picture = Image.fromarray(to_grey(values, low, high, bits=bits))
    text = PngImagePlugin.PngInfo()
    text.add_text("black", repr(low))
    text.add_text("white", repr(high))
    with written_whole(path) as temporary:
        picture.save(temporary, format="PNG", pnginfo=text)
    return low, high


def to_grey(
    values: NDArray[Any], black: float, white: float, *, bits: Literal[8, 16] = 8
) -> NDArray[Any]:
    """Scale values linearly to integers, black to 0 and white to the largest; NaN becomes 0."""
    if bits not in (8, 16):
        raise ValueError(f"expected 8 or 16 bits, got {bits}")
    if not (np.isfinite(black) and np.isfinite(white) and black <= white):
        raise ValueError(f"expected black <= white, both finite, got {black} and {white}")
    span = (white - black) or 1.0
    share = np.clip((np.asarray(values, dtype=np.float64) - black) / span, 0.0, 1.0)
    grey: NDArray[Any] = np.rint(np.nan_to_num(share, nan=0.0) * (2**bits - 1))
    return grey.astype(np.uint8 if bits == 8 else np.uint16)


def finite_range(values: NDArray[Any]) -> tuple[float, float]:
    """Return the smallest and the largest finite value; (0, 0) if there is none."""
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)


def export_burst(burst: Burst, path: str | Path) -> None:
    """Write a burst as NPZ (every field, readable by `load_image_stack`) or TIFF (amplitude).

    In NPZ phasors of several frequencies stand for the amplitude, as `Burst.from_arrays` takes it.
    OME-TIFF (`.ome.tif`) and FITS hold amplitude and distance, with NaN where pixels are not valid;
    TIFF keeps their numbers and says nothing of `valid`.

    Raises
    ------
    ValueError
        If the ending is not supported, or complex frames go to TIFF.
    DataError
        If the file cannot be written.
    """
    if Path(path).suffix.lower() == ".npz":
        fields = {name: getattr(burst, name) for name in _BURST_ARRAYS}
        fields |= {"pitch_mm": burst.grid.pitch_mm, "offset_source": burst.offset_source}
        if burst.phasors is not None:  # whose amplitudes are those of the highest
            fields["amplitude"] = burst.phasors
        fields |= intrinsics_fields(burst.intrinsics)
        write_npz(path, fields | {"meta": to_json(burst.meta, "meta")})
    elif is_ome(path):
        export_ome(burst, path)
    elif is_fits(path):
        export_fits(burst, path)
    elif Path(path).suffix.lower() in TIFF_SUFFIXES:
        export_image(burst.amplitude, path, pitch_mm=_told_pitch_mm(burst))
    else:
        raise ValueError(
            f"expected a name that ends in .npz, .tif, .ome.tif or .fits, got {Path(path).name!r}"
        )


def export_reconstruction(
    reconstruction: Reconstruction,
    path: str | Path,
    *,
    bits: Literal[8, 16] = 8,
    keep_flying: bool = False,
    normals: bool = False,
) -> tuple[float, float] | None:
    """Write a reconstruction as NPZ, PLY, PCD, OME-TIFF, FITS, TIFF or PNG, by the name's ending.

    NPZ holds every field, and `point_m` [row col 3] where it is known where the pixels look. PLY
    and PCD hold the points of `Reconstruction.point_cloud`, OME-TIFF (`.ome.tif`)
    and FITS all images with their errors, TIFF and PNG the first channel.

    Parameters
    ----------
    bits : of a PNG pixel
    keep_flying, normals : of PLY and PCD, as in `Reconstruction.point_cloud`

    Returns
    -------
    The range of grey values as `export_image` does; None where all numbers are kept.

    Raises
    ------
    ValueError
        If the ending is not supported, a complex channel goes to TIFF or PNG, or points lack
        distances or intrinsics.
    DataError
        If the file cannot be written.
    """
    channels = reconstruction.channels
    if Path(path).suffix.lower() in CLOUD_SUFFIXES:
        cloud = reconstruction.point_cloud(keep_flying=keep_flying, normals=normals)
        save_point_cloud(cloud, path)
        return None
    if is_ome(path) or is_fits(path):
        (export_ome if is_ome(path) else export_fits)(reconstruction, path)
        return None
    if Path(path).suffix.lower() != ".npz":
        if not channels:
            raise ValueError("expected a reconstruction with at least one channel, got none")
        image = next(iter(channels.values())).image
        return export_image(image, path, bits=bits, pitch_mm=_told_pitch_mm(reconstruction))
    fields = {name: getattr(reconstruction, name) for name in ("scale", "method", "flying")}
    fields |= {"pitch_mm": reconstruction.grid.pitch_mm}
    fields |= {"settings": to_json(reconstruction.settings, "settings")}
    parts = ("std", "misfit", "fine", "confidence", "prior_weight", "noise_sigma", "noise_gain")
    for channel, estimate in channels.items():
        name = "distance_m" if channel == "distance" else channel
        fields |= {name: estimate.image, f"{name}_status": estimate.status.name.lower()}
        fields[f"{name}_objective"] = np.asarray(estimate.objective, dtype=np.float64)
        fields |= {f"{name}_{part}": getattr(estimate, part) for part in parts}
    if reconstruction.intrinsics is not None:
        fields |= intrinsics_fields(reconstruction.intrinsics)
        if reconstruction.distance_m is not None:
            image = reconstruction.distance_m.image
            fields["point_m"] = points_m(image, reconstruction.intrinsics)
    write_npz(path, fields)
    return None


def _as_real(image: ArrayLike) -> NDArray[Any]:
    values = np.asarray(image)
    if values.dtype.kind == "c":
        raise ValueError("expected a real image, got complex numbers; export np.abs(image) or NPZ")
    if values.dtype.kind not in "uifb":
        raise ValueError(f"expected numbers, got dtype {values.dtype}")
    if values.ndim not in (2, 3) or values.size == 0:
        raise ValueError(f"expected [row col] or [frame row col], got shape {values.shape}")
    return values


def _write_tiff(
    values: NDArray[Any], path: str | Path, pitch_mm: tuple[float, float] | None
) -> tuple[float, float]:
    import tifffile

    if values.dtype not in (np.uint8, np.uint16):
        low, high = finite_range(values)
        if max(abs(low), abs(high)) > float(np.finfo(np.float32).max):
            raise ValueError("expected values that float32 can hold; export NPZ")
        values = values.astype(np.float32)
    tags: dict[str, Any] = {"software": SOFTWARE, "photometric": "minisblack"}
    if pitch_mm is not None:
        per_cm = (10 / pitch_mm[1], 10 / pitch_mm[0])
        tags |= {"resolution": per_cm, "resolutionunit": "CENTIMETER"}
    with written_whole(path) as temporary:
        tifffile.imwrite(temporary, values, **tags)
    return finite_range(values)


def is_ome(path: str | Path) -> bool:
    """Tell whether a name asks for OME-TIFF."""
    return Path(path).name.lower().endswith(OME_ENDINGS)


def is_fits(path: str | Path) -> bool:
    """Tell whether a name asks for FITS."""
    return Path(path).suffix.lower() in FITS_SUFFIXES


def _layers(value: Burst | Reconstruction) -> list[PictureLayer]:
    """Return the images of a burst or a result, those of a burst with NaN where it is not valid."""
    layers = picture_layers(value)
    if isinstance(value, Reconstruction) or value.valid.all():
        return layers
    nan = np.float32(np.nan)
    return [
        one if one.name == "valid" else replace(one, values=np.where(value.valid, one.values, nan))
        for one in layers
    ]


def _told_pitch_mm(value: Burst | Reconstruction) -> tuple[float, float] | None:
    told = value.grid.tells_pitch(value.scale if isinstance(value, Reconstruction) else 1)
    return value.grid.pitch_mm if told else None


def export_ome(value: Burst | Reconstruction, path: str | Path) -> None:
    """Write all images as float32 channels of an OME-TIFF, with names, and pixel size if told."""
    import tifffile

    layers = _layers(value)
    stack = np.stack([one.values.astype(np.float32) for one in layers], axis=-3)
    told: dict[str, Any] = {
        "axes": "TCYX" if stack.ndim == 4 else "CYX",
        "Channel": {
            "Name": [f"{one.name} ({one.unit})" if one.unit else one.name for one in layers]
        },
    }
    for axis, pitch_mm in zip("YX", _told_pitch_mm(value) or (), strict=False):
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
    for one in _layers(value):
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
    if pitch_mm := _told_pitch_mm(value):
        on_sensor = (1.0, 1.0), pitch_mm[::-1]
        header.update(cards(("X", "Y"), "mm", *on_sensor, "A" if straight else " "))
