"""Frames that differ in noise: what one law for all of them makes of a burst, and what is made now.

python benchmarks/frame_noise.py --seed 4000 --bursts 24

Mosaics and parts of photographs at an SNR of 80, 4 frames on a square, 5 and 9 at random places;
one frame of four times the noise, or all from half to four times of it. Nothing moves and all
shifts are right, so that each warning is a false one.
"""

from __future__ import annotations

import argparse
import warnings

import numpy as np
from movement import SCALE, SCENES, Array, scene_of, seen, square

from lensshift import Burst, reconstruct
from lensshift.reconstruction.learned import noise as learned_noise

SNR, BORDER = 80.0, 4


def noise_of(kind: str, count: int, rng: np.random.Generator) -> Array:
    """Return the noise of each frame over the usual one."""
    if kind == "four times":
        return np.where(np.arange(count) == rng.integers(count), 4.0, 1.0)
    return rng.permutation(np.geomspace(0.5, 4.0, count)) if kind == "all" else np.ones(count)


def burst_of(kind: str, number: int, seed: int, phasors: bool) -> tuple[Burst, Array]:
    """Return a burst and the picture of its scene."""
    rng = np.random.default_rng([seed, number])
    scene, count = scene_of(SCENES[number % 4], rng), (4, 5, 9)[number % 3]
    offset_px = square(2) if count == 4 else rng.uniform(-0.5, 0.5, (count, 2))
    offset_px = np.round(8 * offset_px) / 8
    y = np.stack([seen(scene, d) for d in offset_px])
    noise = rng.standard_normal((2, *y.shape)) * (noise_of(kind, count, rng) / SNR)[:, None, None]
    y = y + noise[0] + (1j * noise[1] if phasors else 0.0)
    modulation = {"modulation_hz": 15e6} if phasors else {}
    burst = Burst.from_arrays(y, offset_px=offset_px, pitch_mm=0.1, **modulation)
    return burst, seen(scene, np.zeros(2), SCALE)


def score(burst: Burst, truth: Array) -> tuple[bool, float]:
    """Return whether something is said, and the PSNR in dB."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        image = reconstruct(burst, std=False).amplitude.image
    inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    return bool(said), float(-10 * np.log10(np.mean((image - truth)[inner] ** 2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=4000)
    parser.add_argument("--bursts", type=int, default=24)
    given = parser.parse_args()
    ours = learned_noise.with_frames
    print("noise of frames  channel    said: one law, now      dB: one law, now")
    for kind in ("even", "four times", "all"):
        for phasors in (False, True):
            found = []
            for law in (lambda law, *seen: law, ours):
                learned_noise.with_frames = law
                bursts = (burst_of(kind, n, given.seed, phasors) for n in range(given.bursts))
                found.append(np.array([score(*one) for one in bursts]))
            said, db = ([one[:, n] for one in found] for n in (0, 1))
            print(
                f"{kind:15}  {'phasors' if phasors else 'amplitude':9}  "
                f"{said[0].sum():9.0f} {said[1].sum():6.0f} of {given.bursts}"
                f"  {db[0].mean():12.2f} {db[1].mean():8.2f}"
            )


if __name__ == "__main__":
    main()
