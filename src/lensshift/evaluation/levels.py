"""From the numbers of a photograph to light: one channel, straight levels, mosaics taken apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Array, Floats
from lensshift.core.errors import warn_quality
from lensshift.core.units import LUMINANCE

CHANNELS = ("luminance", "red", "green", "blue")
_MOST_OF_8_BITS = 256  # some count one more
_LEAST_USED = 1.0 / 15.0  # of the levels of a table; 12 bits are a sixteenth of 16
PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")


def linear_light(
    levels: ArrayLike, curve: float | ArrayLike | None = None, *, white: float | None = None
) -> Floats:
    """Undo the tone curve of a camera.

        light = white (level / white)^gamma,   or a table (level, light), straight in between

    Parameters
    ----------
    levels : of any shape
    curve : gamma, as 2.2 for sRGB photographs; or [n 2], the measured opto-electronic conversion
        function (OECF) with rising levels; None: levels are proportional to light already
    white : level of white; the largest one of integers, 1 of floats if None

    Raises
    ------
    ValueError
        If the curve is neither a positive number nor a rising table of light that reaches all
        levels.

    Warns
    -----
    QualityWarning
        If table and image seem to count levels in different units.
    """
    values = np.asarray(levels)
    light = values.astype(np.float64)
    if curve is None:
        return light
    table = np.asarray(curve, dtype=np.float64)
    if table.ndim == 0:
        gamma = float(table)
        if not (np.isfinite(gamma) and gamma > 0):
            raise ValueError(f"expected a positive gamma, got {gamma}")
        whole = np.iinfo(values.dtype).max if values.dtype.kind in "ui" else 1.0
        top = whole if white is None else white
        return np.asarray(top * np.maximum(light / top, 0.0) ** gamma)
    if table.ndim != 2 or table.shape[1] != 2 or len(table) < 2 or not np.isfinite(table).all():
        raise ValueError(f"expected an OECF [n 2] of (level, light), got shape {table.shape}")
    if np.any(np.diff(table, axis=0) <= 0):
        raise ValueError("expected an OECF with rising levels and rising light")
    if table[0, 1] < 0.0:
        raise ValueError("expected an OECF of light, got less than 0: is it log10 of the exposure?")
    low, high = table[0, 0], table[-1, 0]
    known = light[np.isfinite(light)]
    if known.size and (known.min() < low or known.max() > high):
        raise ValueError(
            f"the OECF knows levels from {low:g} to {high:g}, the image has "
            f"{known.min():g} to {known.max():g}"
        )
    kind, used = values.dtype.kind, known.max(initial=low)
    least = {"u": _LEAST_USED * high, "f": min(_LEAST_USED * high, 1.01)}.get(kind, low)
    if high > _MOST_OF_8_BITS if values.dtype == np.uint8 else used < least:
        warn_quality(
            f"the image has levels to {used:g}, the OECF knows {high:g}: are they in one unit (8, "
            "12 or 16 bits, or shares of white)?"
        )
    return np.asarray(np.interp(light, table[:, 0], table[:, 1]))


def one_channel(image: ArrayLike, channel: str | None = None) -> Array:
    """Return a channel [row col] of linear light [row col 3], or a grey image itself.

    Luminance, the default, is 0.2125 R + 0.7154 G + 0.0721 B. ValueError for other images.
    """
    values = np.asarray(image)
    if values.ndim == 2:
        if channel not in (None, "luminance"):
            raise ValueError(f"expected a colour image for channel {channel}, this one is grey")
        return values
    if values.ndim != 3 or values.shape[2] != 3:
        raise ValueError(f"expected an image [row col] or [row col 3], got shape {values.shape}")
    if channel in (None, "luminance"):
        return np.asarray(values @ np.array(LUMINANCE))
    if channel not in CHANNELS:
        raise ValueError(f"expected a channel of {', '.join(CHANNELS)}, got {channel!r}")
    return np.ascontiguousarray(values[..., ("red", "green", "blue").index(channel)])


def bayer_frames(mosaic: ArrayLike, pattern: str, channel: str = "green") -> tuple[Array, Floats]:
    """Return the pixels of one colour of a mosaic as frames [frame row col], and their offsets.

    Red and blue are one frame, green is two, each of half the rows and columns: nothing is
    interpolated. The offsets [frame 2], in pixels of the frames, are what `measure_edges` takes:
    the content of the second green frame lies where its pixels are not. The pattern has the colours
    of two rows, as "RGGB". ValueError if pattern, channel or shape does not fit.
    """
    values = np.asarray(mosaic)
    if values.ndim != 2 or min(values.shape) < 2:
        raise ValueError(f"expected a mosaic [row col], got shape {values.shape}")
    if pattern.upper() not in PATTERNS:
        raise ValueError(f"expected a pattern of {', '.join(PATTERNS)}, got {pattern!r}")
    if channel not in ("red", "green", "blue"):
        raise ValueError(f"expected red, green or blue of a mosaic, got {channel!r}")
    rows, cols = (n // 2 * 2 for n in values.shape)
    places = [k for k, one in enumerate(pattern.upper()) if one == channel[0].upper()]
    frames = [values[k // 2 : rows : 2, k % 2 : cols : 2] for k in places]
    corners = np.array([(k // 2, k % 2) for k in places], dtype=np.float64)
    return np.stack(frames), 0.5 * (corners[0] - corners)
