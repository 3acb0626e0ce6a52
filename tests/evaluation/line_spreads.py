"""Edges seen through any optics, made in Fourier space: the MTF is known exactly."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import j1

Array = NDArray[np.float64]
Transfer = Callable[[Array], NDArray[np.complex128] | Array]

_STEP_PX = 1.0 / 32.0
_PERIOD = 1 << 17  # samples: 4096 px, the other edge is half of them away
_FREQUENCY_CPP = np.fft.rfftfreq(_PERIOD, _STEP_PX)


def gauss(sigma_px: float) -> Transfer:
    return lambda f: np.exp(-2.0 * (np.pi * sigma_px * f) ** 2)


def diffraction(cutoff_cpp: float) -> Transfer:
    """A round pupil without aberrations."""

    def transfer(f: Array) -> Array:
        u = np.clip(np.abs(f) / cutoff_cpp, 0.0, 1.0)
        return np.asarray(2.0 / np.pi * (np.arccos(u) - u * np.sqrt(1.0 - u**2)))

    return transfer


def disc(radius_px: float) -> Transfer:
    def transfer(f: Array) -> Array:
        x = 2.0 * np.pi * radius_px * np.abs(f) + 1e-12
        return np.asarray(2.0 * j1(x) / x)

    return transfer


def motion(length_px: float) -> Transfer:
    return lambda f: np.sinc(length_px * f)


def with_part(core: Transfer, share: float, spread: Transfer) -> Transfer:
    """Send a share of the light elsewhere."""
    return lambda f: np.asarray(core(f) * (1.0 - share + share * spread(f)))


def halo(share: float, length_px: float) -> Transfer:
    """Scatter a share exponentially."""
    return with_part(gauss(0.5), share, lambda f: 1.0 / (1.0 + (2.0 * np.pi * length_px * f) ** 2))


def ghost(share: float, away_px: float) -> Transfer:
    return with_part(gauss(0.5), share, lambda f: np.exp(-2j * np.pi * f * away_px))


def coma(share: float, length_px: float) -> Transfer:
    """Give a share a tail to one side; its mean stays."""

    def spread(f: Array) -> NDArray[np.complex128]:
        turn = 2j * np.pi * f * length_px
        return np.asarray(np.exp(turn) / (1.0 + turn))

    return with_part(gauss(0.5), share, spread)


def sharpened(sigma_px: float, amount: float) -> Transfer:
    """Take an unsharp mask of a width."""
    return lambda f: np.asarray(gauss(0.5)(f) * (1.0 + amount * (1.0 - gauss(sigma_px)(f))))


class Edge:
    """A straight edge under some optics, seen by square pixels.

    Parameters
    ----------
    transfer : OTF of the optics along the normal
    angle_deg : of the edge against the columns
    side_px : of the pixels
    """

    def __init__(self, transfer: Transfer, angle_deg: float, side_px: float = 1.0) -> None:
        self._angle_rad, self._side_px, self._optics = np.deg2rad(angle_deg), side_px, transfer
        index = np.arange(_FREQUENCY_CPP.size)
        wave = np.zeros(index.size, np.complex128)  # a square wave from 0 to 1
        wave[1::2] = 1.0 / (1j * np.pi * index[1::2])
        wave[0] = 0.5
        values = np.fft.irfft(_PERIOD * wave * self.transfer(_FREQUENCY_CPP), _PERIOD)
        self._response = np.roll(values, _PERIOD // 2)
        self._normal_px = (np.arange(_PERIOD) - _PERIOD // 2) * _STEP_PX

    def transfer(self, frequency_cpp: Array) -> NDArray[np.complex128] | Array:
        """Return the OTF of optics and pixel."""
        side = self._side_px * frequency_cpp
        pixel = np.sinc(side * np.cos(self._angle_rad)) * np.sinc(side * np.sin(self._angle_rad))
        return np.asarray(self._optics(frequency_cpp) * pixel)

    def mtf50_cpp(self) -> float:
        frequency_cpp = np.linspace(0.0, 1.6, 160_001)
        return float(frequency_cpp[np.argmax(np.abs(self.transfer(frequency_cpp)) < 0.5)])

    def image(self, shape: tuple[int, int], place_px: float = 0.0) -> Array:
        """Return [row col], 0 on the dark side and 1 on the bright one."""
        row, col = (np.arange(n) - (n - 1) / 2 for n in shape)
        normal_px = col * np.cos(self._angle_rad) + row[:, None] * np.sin(self._angle_rad)
        return np.interp(normal_px - place_px, self._normal_px, self._response)


# What benchmarks/edge_families.py measures; the first set served while the method was made.
SEEN = {
    "diffraction 1.2 c/px": diffraction(1.2),
    "diffraction 0.6 c/px": diffraction(0.6),
    "halo 5 px": halo(0.1, 5.0),
    "ghost 10 px": ghost(0.1, 10.0),
    "coma 2.5 px": coma(0.3, 2.5),
    "sharpened": sharpened(1.0, 0.5),
    "sharpened wide": sharpened(3.0, 0.3),
    "gaussian 0.5 px": gauss(0.5),
    "disc 1.5 px": disc(1.5),
    "motion 3 px": lambda f: gauss(0.5)(f) * motion(3.0)(f),
}
UNSEEN = {
    "diffraction 0.9 c/px": diffraction(0.9),
    "halo 3 px": halo(0.07, 3.0),
    "halo gaussian 6 px": with_part(gauss(0.45), 0.08, gauss(6.0)),
    "ghost 7 px": ghost(0.06, 7.0),
    "coma 1.5 px": coma(0.4, 1.5),
    "defocus": lambda f: diffraction(1.0)(f) * disc(1.2)(f),
    "gaussian 0.8 px": gauss(0.8),
    "sharpened 2 px": sharpened(2.0, 0.4),
}
