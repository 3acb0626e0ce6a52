"""Reflectance in the near infrared as a function of the place on a surface, in metres.

A texture takes (x_m, y_m), x to the right and y down as one looks at the front of the surface,
and returns the share of the light, 0 to 1, that the surface scatters. Textures are sharp:
whatever blurs them is the camera's business.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Array, Floats
from lensshift.scene.checks import number, positive, positives, share, table

Texture = Callable[[Floats, Floats], Array]

DARK, BRIGHT = 0.05, 0.85  # black and white card


@dataclass(frozen=True, slots=True)
class Constant:
    """The same reflectance everywhere."""

    reflectance: float

    def __post_init__(self) -> None:
        share("reflectance", self.reflectance)

    def __call__(self, x_m: Floats, y_m: Floats) -> Floats:
        """Return the reflectance at (x, y)."""
        return np.full(np.broadcast(x_m, y_m).shape, float(self.reflectance))


@dataclass(frozen=True, slots=True)
class Checker:
    """A chessboard whose corners meet at (0, 0); the squares below right of it are dark.

    Parameters
    ----------
    size_m : side of a square
    """

    size_m: float
    dark: float = DARK
    bright: float = BRIGHT

    def __post_init__(self) -> None:
        _two_tones(self)
        positive("size_m", self.size_m)

    def __call__(self, x_m: Floats, y_m: Floats) -> Floats:
        """Return the reflectance at (x, y)."""
        square = np.floor(x_m / self.size_m) + np.floor(y_m / self.size_m)
        return np.where(np.mod(square, 2.0) == 0.0, self.dark, self.bright)


@dataclass(frozen=True, slots=True)
class Edge:
    """Two half-planes: dark on the left, bright on the right of a line through (0, 0).

        bright where x cos(slant) - y sin(slant) > 0

    Parameters
    ----------
    slant_rad : from the vertical; positive: the edge moves right as it goes down
    """

    slant_rad: float
    dark: float = DARK
    bright: float = BRIGHT

    def __post_init__(self) -> None:
        _two_tones(self)
        number("slant_rad", self.slant_rad)

    def __call__(self, x_m: Floats, y_m: Floats) -> Floats:
        """Return the reflectance at (x, y)."""
        right_of_edge = x_m * math.cos(self.slant_rad) - y_m * math.sin(self.slant_rad) > 0
        return np.where(right_of_edge, self.bright, self.dark)


@dataclass(frozen=True, slots=True)
class SiemensStar:
    """A star of bright and dark sectors about (0, 0), with their mean around it.

        mean + half range * sin(cycles * angle),   a cycle at radius r is 2 pi r / cycles

    Parameters
    ----------
    radius_m : of the star
    cycles : pairs of sectors
    binary : only the sign of the sine: sharp sectors
    """

    radius_m: float
    cycles: int = 12
    dark: float = DARK
    bright: float = BRIGHT
    binary: bool = False

    def __post_init__(self) -> None:
        _two_tones(self)
        positive("radius_m", self.radius_m)
        if positive("cycles", self.cycles) != int(self.cycles):
            raise ValueError(f"expected a whole number of cycles, got {self.cycles}")
        if not isinstance(self.binary, bool):
            raise TypeError(f"expected true or false for binary, got {self.binary!r}")

    def __call__(self, x_m: Floats, y_m: Floats) -> Floats:
        """Return the reflectance at (x, y)."""
        wave = np.sin(self.cycles * np.arctan2(y_m, x_m))
        if self.binary:
            wave = np.where(wave > 0, 1.0, -1.0)
        inside = np.hypot(x_m, y_m) <= self.radius_m
        return _between(self.dark, self.bright, np.where(inside, wave, 0.0))


@dataclass(frozen=True, slots=True)
class ZonePlate:
    """Rings about (0, 0) that become finer in proportion to their radius, bright in the middle.

        mean + half range * cos(pi r^2 / (radius * finest period))

    The local period at r is finest_period * radius / r. Around the rings lies their mean.

    Parameters
    ----------
    radius_m : of the last ring
    finest_period_m : from bright to bright at that radius
    """

    radius_m: float
    finest_period_m: float
    dark: float = DARK
    bright: float = BRIGHT

    def __post_init__(self) -> None:
        _two_tones(self)
        positive("radius_m", self.radius_m)
        positive("finest_period_m", self.finest_period_m)

    def __call__(self, x_m: Floats, y_m: Floats) -> Floats:
        """Return the reflectance at (x, y)."""
        square = x_m * x_m + y_m * y_m
        wave = np.cos(math.pi * square / (self.radius_m * self.finest_period_m))
        return _between(self.dark, self.bright, np.where(square <= self.radius_m**2, wave, 0.0))


@dataclass(frozen=True, slots=True)
class LinePairs:
    """Bands of vertical bars below each other, one period each, with their mean around them.

    The bands share the height of a square about (0, 0); each starts with a bright bar at the
    left side and ends with its last whole pair.

    Parameters
    ----------
    period_m : of each band from top to bottom, a bright and a dark bar together
    size_m : side of the square
    """

    period_m: tuple[float, ...]
    size_m: float
    dark: float = DARK
    bright: float = BRIGHT

    def __post_init__(self) -> None:
        _two_tones(self)
        positive("size_m", self.size_m)
        object.__setattr__(self, "period_m", positives("period_m", self.period_m))
        if not self.period_m or max(self.period_m) > self.size_m:
            raise ValueError(
                f"expected periods of up to size_m {self.size_m} for period_m, got {self.period_m}"
            )

    def __call__(self, x_m: Floats, y_m: Floats) -> Floats:
        """Return the reflectance at (x, y)."""
        periods = np.array(self.period_m)
        from_top = (y_m / self.size_m + 0.5) * len(periods)
        band = np.clip(np.floor(from_top), 0, len(periods) - 1).astype(np.intp)
        pair = (x_m + 0.5 * self.size_m) / periods[band]
        # 1e-9: a side that holds a whole number of pairs keeps its last one despite rounding.
        pairs = np.floor(self.size_m / periods + 1e-9)[band]
        inside = (from_top >= 0) & (from_top < len(periods)) & (pair >= 0) & (pair < pairs)
        wave = np.where(np.mod(pair, 1.0) < 0.5, 1.0, -1.0)
        return _between(self.dark, self.bright, np.where(inside, wave, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class ImageTexture:
    """A picture on a rectangle about (0, 0), bilinear between the centres of its pixels.

    Pixel i of n along an axis is centred at ((i + 1/2) / n - 1/2) size. Beyond the outermost
    centres, also off the rectangle, the outermost pixels go on.

    Parameters
    ----------
    image : [row col], 0 to 1
    size_m : (x, y) that the whole picture covers
    """

    image: ArrayLike
    size_m: tuple[float, float]

    def __post_init__(self) -> None:
        image = table("image", self.image)
        if not np.all((image >= 0) & (image <= 1)):
            raise ValueError(
                f"expected reflectances from 0 to 1 for image, got {image.min()} to {image.max()}"
            )
        object.__setattr__(self, "image", image)
        object.__setattr__(self, "size_m", positives("size_m", self.size_m, 2))

    def __call__(self, x_m: Floats, y_m: Floats) -> Floats:
        """Return the reflectance at (x, y)."""
        from scipy.ndimage import map_coordinates

        image = np.asarray(self.image)
        (width_m, height_m), (rows, cols) = self.size_m, image.shape
        row, col = (y_m / height_m + 0.5) * rows - 0.5, (x_m / width_m + 0.5) * cols - 0.5
        places = np.stack(np.broadcast_arrays(row, col))
        seen: Floats = map_coordinates(image, places, order=1, mode="nearest")
        return np.clip(seen, 0.0, 1.0)  # rounding


def _two_tones(texture: Checker | Edge | SiemensStar | ZonePlate | LinePairs) -> None:
    share("dark", texture.dark)
    share("bright", texture.bright)


def _between(dark: float, bright: float, wave: Floats) -> Floats:
    """Return reflectance that swings from dark to bright as a wave does from -1 to 1."""
    seen: Floats = 0.5 * (1.0 - wave) * dark + 0.5 * (1.0 + wave) * bright
    return np.clip(seen, min(dark, bright), max(dark, bright))  # rounding
