"""Light that lens and sensor throw far from where it belongs, and frames without it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array, Floats
from lensshift.core.errors import DataError
from lensshift.core.settings import built


@dataclass(frozen=True, slots=True)
class StrayLight:
    """A share of the light, spread over a wide Gaussian; of time-of-flight frames with its phase.

        y = (1 - s) x + s G x

    A near bright object so pulls dark surfaces around it towards its own distance: a hundredth of
    light twenty times as bright, half a radian away (0.8 m at 15 MHz), by 0.1 rad (0.16 m).

    Parameters
    ----------
    share : s, 0 to 0.5
    sigma_px : of the Gaussian, of sum 1, in LR pixels; what leaves the sensor comes back as if the
        image went on as its mirror image
    share_std : standard deviation of the share, as of its measurement
    """

    share: float
    sigma_px: float
    share_std: float = 0.0

    def __post_init__(self) -> None:
        for name, value, least, most in (
            ("share", self.share, 0.0, 0.5),
            ("sigma_px", self.sigma_px, 0.5, np.inf),
            ("share_std", self.share_std, 0.0, 0.5),
        ):
            if not least <= value <= most:
                problem = f"expected {least:g} to {most:g}, got {value!r}"
                raise ValueError(f"stray_light.{name}: {problem}")

    @classmethod
    def told(cls, table: Any, where: str = "meta.stray_light") -> StrayLight | None:
        """Return what `Burst.meta`, or the settings of a result, say of stray light; None: nothing.

        DataError if that is none.
        """
        if table is None:
            return None
        if not isinstance(table, Mapping):
            raise DataError(f"expected share, sigma_px, got {table!r:.40}", field=where)
        return built(cls, table, where)

    @property
    def table(self) -> dict[str, float]:
        """As `Burst.meta` and the settings of a result keep it."""
        return asdict(self)

    def spread(self, frames: Array) -> Array:
        """Return G x of frames [... row col], real or complex."""
        return _times(frames, _transfer(frames.shape[-2:], self.sigma_px))

    def added(self, frames: Array) -> Array:
        """Return what is seen of frames [... row col] without stray light."""
        return (1.0 - self.share) * frames + self.share * self.spread(frames)

    def removed(self, frames: Array) -> Array:
        """Return frames [... row col] without the stray light in them, exactly.

        x = (1 - s + s G)^-1 y
        """
        seen = 1.0 - self.share + self.share * _transfer(frames.shape[-2:], self.sigma_px)
        return _times(frames, 1.0 / seen)

    def std_of(self, image: Array, frames: Array) -> Floats:
        """Return what `share_std` leaves open of a picture: std [row col] along and across it.

            |G x - x| share_std

        Parameters
        ----------
        image : [row col] without stray light, with a whole number of pixels to one of the frames
        frames : [frame row col] in its unit
        """
        around = self.spread(frames.mean(axis=0))
        times = image.shape[0] // around.shape[0]
        wrong = around.repeat(times, axis=0).repeat(times, axis=1) - image
        if np.iscomplexobj(image):
            wrong = wrong * np.exp(-1j * np.angle(image))
        return self.share_std * np.stack([np.abs(wrong.real), np.abs(wrong.imag)])


def _transfer(shape: tuple[int, ...], sigma_px: float) -> Floats:
    """Return the Gaussian's factors [row col] of cosines that are mirrored at the borders."""
    rows, cols = (np.exp(-0.5 * (np.pi * sigma_px / n * np.arange(n)) ** 2) for n in shape)
    return np.asarray(rows[:, None] * cols)


def _times(frames: Array, factor: Floats) -> Array:
    from scipy.fftpack import dctn, idctn

    def real(part: NDArray[Any]) -> NDArray[Any]:
        waves = dctn(part, axes=(-2, -1), norm="ortho")
        return np.asarray(idctn(factor * waves, axes=(-2, -1), norm="ortho", overwrite_x=True))

    if np.iscomplexobj(frames):
        return real(frames.real) + 1j * real(frames.imag)
    return real(np.asarray(frames, np.float64))
