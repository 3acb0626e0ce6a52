"""Distances of several modulation frequencies: each has its phasors, together they have one turn.

A pixel that sees two surfaces mixes the light of each frequency by itself, so each gives its own
picture of phasors. Which turn the highest one is in is asked afterwards, in the fine picture, where
few pixels are mixed, and they take the turns of those that are not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.units import SPEED_OF_LIGHT_MPS

Array = NDArray[Any]

AROUND_HR_PX = 7  # along the window in which a turn is looked for
ALIKE = 1.0 / 16.0  # of a turn: what four pixels of one surface may differ by
FARTHEST_M = 200.0  # no camera that counts turns sees farther
SURE_SIGMAS = 3.0  # the usual 3 sigma
FORBIDDEN = 1e12  # chi-square that no noise reaches


@dataclass(frozen=True, slots=True, eq=False)
class Tones:
    """Pictures of one scene, one for each modulation frequency.

    Parameters
    ----------
    hz : [frequency]
    phase_rad : [frequency row col]
    std_rad : same shape, standard deviation of the phases
    """

    hz: tuple[float, ...]
    phase_rad: NDArray[np.float64]
    std_rad: NDArray[np.float64]

    @property
    def rad_per_m(self) -> NDArray[np.float64]:
        """4 pi f / c, [frequency 1 1]."""
        return 4.0 * np.pi / SPEED_OF_LIGHT_MPS * np.asarray(self.hz)[:, None, None]

    @property
    def turn_m(self) -> float:
        """c / 2f of the highest frequency."""
        return SPEED_OF_LIGHT_MPS / 2.0 / max(self.hz)

    @property
    def repeat_m(self) -> float:
        """Distance after which all phases are back, c / (2 gcd f), at most 200 m."""
        common_hz = max(math.gcd(*(round(hz) for hz in self.hz)), 1)
        return min(SPEED_OF_LIGHT_MPS / 2.0 / common_hz, FARTHEST_M)

    def off_rad(self, distance_m: Array) -> NDArray[np.float64]:
        """Return how far the phases are from those of a distance [row col], within half a turn."""
        return np.asarray(np.angle(np.exp(1j * (self.phase_rad - self.rad_per_m * distance_m))))

    def distance_m(
        self, between_m: tuple[Array, Array] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Return the distance [row col] that fits all phases, its std, and where the turn is sure.

            n = argmin C_n,   C_n = 2 sum_f (1 - cos(phi_f - 4 pi f d_n / c)) / s_f^2
            d_n = d_fastest + n c / 2f
            d = d_n + sum_f w_f (phi_f - 4 pi f d_n / c) c / (4 pi f) / sum_f w_f,
            w_f = (4 pi f / (c s_f))^2

        C_n is a chi-square: the turn is sure where the second best is 3 sigma worse. The standard
        deviation grows with what the frequencies contradict each other by.

        Parameters
        ----------
        between_m : least and largest distance [row col] that the turn may lead to, each by half a
            turn more; None: all up to `repeat_m`
        """
        fastest, per_m, turn_m = int(np.argmax(self.hz)), self.rad_per_m, self.turn_m
        first_m = np.mod(self.phase_rad[fastest] / per_m[fastest], turn_m)
        best_m, least = first_m, np.full(first_m.shape, np.inf)
        second = least
        for number in range(math.ceil(self.repeat_m / turn_m - 1e-6)):
            tried_m = first_m + number * turn_m
            cost = 2.0 * np.sum((1.0 - np.cos(self.off_rad(tried_m))) / self.std_rad**2, axis=0)
            if between_m is not None:
                low_m, high_m = between_m
                away = np.maximum(low_m - tried_m, tried_m - high_m) > 0.5 * turn_m
                cost = np.where(away, cost + FORBIDDEN, cost)
            second = np.minimum(np.maximum(cost, least), second)
            best_m, least = np.where(cost < least, tried_m, best_m), np.minimum(cost, least)
        sure = second - least > SURE_SIGMAS**2
        weight = (per_m / self.std_rad) ** 2
        total, off_rad = weight.sum(axis=0), self.off_rad(best_m)
        correction_m = np.sum(weight * off_rad / per_m, axis=0) / total
        left = np.sum(((off_rad - per_m * correction_m) / self.std_rad) ** 2, axis=0)
        doubt = np.maximum(left / max(len(self.hz) - 1, 1), 1.0)
        return best_m + correction_m, np.sqrt(doubt / total), sure


def common_distance(pictures: Tones) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distance [row col] of all frequencies, and its standard deviation.

    A pixel that sees two surfaces has phases of none, and its turn may be any. Where four pixels
    agree on a distance they see one surface; all others may only be in the turns of those around,
    or between them.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    found_m, std_m, sure = pictures.distance_m()
    apart_m = maximum_filter(found_m, 2, mode="constant", cval=np.inf) - minimum_filter(found_m, 2)
    one = maximum_filter(apart_m < ALIKE * pictures.turn_m, 2, origin=-1) & sure
    if not one.any():
        return found_m, std_m
    low_m = minimum_filter(np.where(one, found_m, np.inf), AROUND_HR_PX)
    high_m = maximum_filter(np.where(one, found_m, -np.inf), AROUND_HR_PX)
    nobody = ~np.isfinite(low_m)
    low_m[nobody], high_m[nobody] = found_m[one].min(), found_m[one].max()
    return pictures.distance_m((low_m, high_m))[:2]
