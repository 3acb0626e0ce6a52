"""What is summed over a pixel: light, phasors, and what the truth wants to know."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array
from lensshift.core.units import distance_to_phase
from lensshift.scene import Hits

_PLAIN = 4  # light, reflectance, light x distance, light x distance^2


@dataclass(frozen=True, slots=True)
class Tones:
    """Frequencies in the correlation of a pixel: modulation frequencies times harmonics."""

    modulation_hz: tuple[float, ...]  # [frequency]
    harmonics: tuple[int, ...] = (1,)  # 1 and those that the pixel hears besides

    @property
    def count(self) -> int:
        """Number of tones."""
        return len(self.modulation_hz) * len(self.harmonics)

    @property
    def channels(self) -> int:
        """Number of real channels that `Seen` needs."""
        return _PLAIN + 2 * self.count

    @property
    def telling(self) -> list[int]:
        """Channels that tell one surface from another: light and the first phasor."""
        return [0, _PLAIN, _PLAIN + self.count]

    def phases(self, distance_m: Array) -> Array:
        """Return the phase of each tone [... tone] for distances [...]."""
        turns = [
            harmonic * distance_to_phase(distance_m, hz)
            for hz in self.modulation_hz
            for harmonic in self.harmonics
        ]
        return np.stack(turns, axis=-1)

    def channels_of(self, hits: Hits, indirect: Array | None = None) -> Array:
        """Return the channels [... channel] of points in the world, see `Seen`.

        Parameters
        ----------
        indirect : [... 1 + 2 tone] light and phasors (all real parts, then all imaginary parts)
            that reach the points from other points, per unit of radiant intensity; broadcasts
        """
        distance_m = np.where(hits.hit, hits.distance_m, 1.0)
        light = hits.reflectance * hits.cos_incidence / distance_m**2
        phase = self.phases(distance_m)
        values = np.empty((*light.shape, self.channels))
        values[..., 0] = light
        values[..., 1] = hits.reflectance
        values[..., _PLAIN : _PLAIN + self.count] = light[..., None] * np.cos(phase)
        values[..., _PLAIN + self.count :] = light[..., None] * np.sin(phase)
        if indirect is not None:
            values[..., 0] += hits.reflectance * indirect[..., 0]
            values[..., _PLAIN:] += hits.reflectance[..., None] * indirect[..., 1:]
        values[..., 2] = values[..., 0] * distance_m
        values[..., 3] = values[..., 2] * distance_m
        return values


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Means over the footprints of pixels, without noise."""

    values: Array  # [row col channel]
    tones: Tones  # of the phasors

    @property
    def light(self) -> Array:
        """[row col] reflectance x cos / distance^2, in 1 / m2, indirect light included."""
        return self.values[..., 0]

    @property
    def reflectance(self) -> Array:
        """[row col] mean reflectance."""
        return self.values[..., 1]

    @property
    def phasor(self) -> NDArray[np.complex128]:
        """[frequency harmonic row col] light x exp(i phase)."""
        count = self.tones.count
        both = np.moveaxis(self.values[..., _PLAIN:], -1, 0)
        shape = (len(self.tones.modulation_hz), len(self.tones.harmonics), *both.shape[1:])
        return np.asarray(both[:count] + 1j * both[count:]).reshape(shape)

    def distances(self) -> tuple[Array, Array]:
        """Return mean and standard deviation [row col] of the distances, weighted with light."""
        weight = np.where(self.light > 0, self.light, 1.0)
        mean = self.values[..., 2] / weight
        variance = self.values[..., 3] / weight - mean**2
        return mean, np.sqrt(np.maximum(variance, 0.0))
