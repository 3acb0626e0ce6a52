"""What bars may hold that no pixel sees: edges, where a sine is all that there is to see."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fftpack import dctn, idctn
from scipy.ndimage import gaussian_filter

from lensshift.core.arrays import Array, Floats

ODD = (3, 5, 7)  # harmonics of bars; of higher ones pixels half as wide show next to nothing
MOST = 50.0  # exponent: far beyond what counts, and still a number
# Half a period of bars whose third harmonic a pixel as wide as its pitch is blind to, LR pixels.
HALF_PERIOD_PX = 1.5


def as_bars(image: Array, std: Floats, blur_px: float, scale: int) -> Floats:
    """Return the std of a picture, no less than what it lacks if its waves are bars.

        v = <|F^-1 h F x|^2> - <|F^-1 e F x|^2>,   h(f) = e(3 f) / p(f) sqrt(sum_n (p(n f) / n)^2)
        e(f) = min(1, |1 - sinc(w f_r) sinc(w f_c) exp(pi^2 w^2 f^2 / 6)|),   n = 3, 5, 7

    Bars of the frequency f have harmonics n f of an n-th of their contrast, of which the third
    tells that there are any. A part e of that is not in the frames: how much less a square pixel
    of the width w sees than a Gaussian of that width, by which the picture is found. The first
    term is the power of the harmonics that are lost with it, < > the mean over half a period, p
    the pixels of the picture. The second is what is drawn where pixels see so little, as beside
    lone edges, which show where they are by all their other frequencies.

    Parameters
    ----------
    image : [row col] real or complex
    std : [row col], of a complex picture [2 row col] along and across its phasors
    blur_px : standard deviation of the pixel response in LR pixels
    """
    hidden, shown = _filters(image.shape, min(blur_px * 12**0.5, 1.0), scale)
    parts = [image] if image.dtype.kind == "f" else [image.real, image.imag]
    waves = [dctn((part - part.mean()).astype(np.float32), norm="ortho") for part in parts]
    lacking, drawn = ([idctn(of * one, norm="ortho") for one in waves] for of in (hidden, shown))
    if len(parts) == 2:
        turn = np.exp(-1j * np.angle(image))  # along and across the picture
        turned = ((one + 1j * other) * turn for one, other in (lacking, drawn))
        lacking, drawn = ([z.real, z.imag] for z in turned)
    power = np.square(lacking) - np.square(drawn)
    reach = (0.0, HALF_PERIOD_PX * scale, HALF_PERIOD_PX * scale)
    power = gaussian_filter(power, reach, mode="reflect").reshape(std.shape)
    return np.asarray(np.sqrt(np.maximum(std**2, power)))


@lru_cache(maxsize=4)
def _filters(
    shape: tuple[int, int], width_px: float, scale: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return what the waves of a picture [row col] are multiplied with: of harmonics, of detail."""

    def at(times: int) -> tuple[Floats, Floats]:
        """Return e, and p."""
        rows, cols = (times * np.arange(n) / (2.0 * n) * scale for n in shape)
        ratio_r, ratio_c = (
            np.sinc(width_px * f) * np.exp(np.minimum((np.pi * width_px * f) ** 2 / 6.0, MOST))
            for f in (rows, cols)
        )
        unseen = np.minimum(np.abs(1.0 - np.outer(ratio_r, ratio_c)), 1.0)
        return unseen, np.outer(np.sinc(rows / scale), np.sinc(cols / scale))

    shown, pixel = at(1)
    lost = np.sqrt(sum((at(n)[1] / n) ** 2 for n in ODD))
    return (at(3)[0] * lost / pixel).astype(np.float32), shown.astype(np.float32)
