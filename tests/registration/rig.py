"""A rig with known faults: its scan of waves that alias, from a closed form."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lensshift.core.types import Burst
from lensshift.registration import calibration_scan_mm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rig:
    px_per_mm: Array = field(default_factory=lambda: np.array([[5.6, 0.12], [-0.15, -5.4]]))
    play_mm: Array = field(default_factory=lambda: np.array([0.012, 0.006]))
    drift_px_per_s: Array = field(default_factory=lambda: np.array([2e-4, -4e-4]))
    repeat_mm: float = 0.0
    noise: float = 0.005
    shape: tuple[int, int] = (16, 64)
    # Terms of the map over the sensor, (row, col) from -1 to 1: row^2, col^2 and row col.
    bending: float = 0.0

    def field_px_per_mm(self) -> Array:
        """Return the true map of every pixel."""
        row, col = np.meshgrid(*(np.linspace(-1, 1, size) for size in self.shape), indexing="ij")
        bend = np.zeros((*self.shape, 2, 2))
        bend[..., 0, 0] = 0.03 * row**2 + 0.3 * col**2
        bend[..., 1, 1] = -0.5 * col**2 + 0.1 * col
        bend[..., 0, 1] = 0.2 * row * col
        bend -= bend.mean(axis=(0, 1))
        return self.px_per_mm + self.bending * bend

    def scan(self, seed: int = 0, steps: int = 3, span_mm: float = 0.2) -> Burst:
        """Return the burst of a calibration scan."""
        rng = np.random.default_rng(seed)
        asked = calibration_scan_mm((3.0, 5.0), span_mm, steps=steps)
        motor = asked + self.repeat_mm * rng.standard_normal(asked.shape)
        load = motor.copy()
        load[0] -= 0.5 * self.play_mm
        for k in range(1, len(load)):  # friction: the load moves once the play is taken up
            load[k] = np.clip(
                load[k - 1], motor[k] - 0.5 * self.play_mm, motor[k] + 0.5 * self.play_mm
            )
        time_s = 2.0 * np.arange(len(asked))
        away = load - (3.0, 5.0)
        offset = np.einsum("rcij,kj->krci", self.field_px_per_mm(), away)
        offset += (self.drift_px_per_s * time_s[:, None])[:, None, None]
        frames = waves_at(offset)
        frames += self.noise * rng.standard_normal(frames.shape)
        return Burst.from_arrays(
            frames,
            offset_px=np.zeros((len(asked), 2)),
            pitch_mm=0.155,
            stage_mm=motor,
            stage_commanded_mm=asked,
            time_s=time_s,
        )


def waves_at(offset_px: Array, highest: float = 0.75) -> Array:
    """Return frames [frame row col] of 60 waves, as pixels of 0.3 px see them, about 0.5."""
    rng = np.random.default_rng(4)
    count, rows, cols, _ = offset_px.shape
    row, col = np.arange(rows)[:, None] - offset_px[..., 0], np.arange(cols) - offset_px[..., 1]
    frames = np.zeros((count, rows, cols))
    for _ in range(60):
        f = rng.uniform(-highest, highest, 2)
        size = np.exp(-2.0 * (np.pi * 0.3) ** 2 * (f @ f)) / (0.03 + f @ f)
        frames += size * np.cos(2 * np.pi * (f[0] * row + f[1] * col) + rng.uniform(0, 6.28))
    return 0.5 + 0.12 * frames / frames.std()
