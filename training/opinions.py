"""Fit what the mean of two pictures of phasors may be off by, and what their likelihood counts.

    python training/opinions.py --bursts 1200 --seed 1

Prints numbers of `lensshift/reconstruction/learned/opinions.py`: a trust by which the means of two
amplitudes are nearest to scenes of `depths.py`, and a law of the variance of phases under which
their errors are likeliest, if they have the tails of Student's t. Five minutes.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
import worlds
from bursts import USUAL_OF_PHASORS, draw_bench
from depths import scene
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from torch import Tensor
from worlds import log_uniform

from lensshift import Burst, reconstruct
from lensshift.core.units import within_half_a_turn
from lensshift.reconstruction.learned import method, opinions, phasors
from lensshift.reconstruction.learned.method import USUAL_SHIFT_ERROR_PX

BORDER = 4
MODULATION_HZ = 15e6
SNR, SHOT = (5.0, 300.0), 0.7  # of a component at the median; share of its variance from light
TAILS = 6  # degrees of freedom
STEPS = 60
# Share of scenes with a relief besides: all that a picture may show, in phases of up to 1.
RELIEF = 0.3
Array = NDArray[np.float64]
Loss = Callable[[int, Tensor], Tensor]


def draw_burst(rng: np.random.Generator) -> tuple[Burst, int, Array]:
    """Return a burst of one scene by a calibrated camera, the scale, and the truth."""
    while (bench := draw_bench(rng, USUAL_OF_PHASORS)).geometry.scale == 1:
        pass  # whose pictures are found on a finer grid
    g = bench.geometry
    light, phase = scene(rng)
    if rng.random() < RELIEF:
        phase = phase + log_uniform(rng, 0.03, 1.0) * worlds.scene(rng)
    top, left = (
        int(rng.integers(n - m + 1)) for n, m in zip(light.shape, g.fine_shape, strict=True)
    )
    part = (slice(top, top + g.fine_shape[0]), slice(left, left + g.fine_shape[1]))
    light, phase = light[part], phase[part]
    parts = [torch.tensor(p)[None] for p in (light * np.cos(phase), light * np.sin(phase), light)]
    wrong = USUAL_SHIFT_ERROR_PX * rng.standard_normal((1, *g.offset_px.shape))
    real, imag, seen = (bench.frames(one, wrong)[0].numpy().astype(np.float64) for one in parts)
    usual = np.median(seen)
    sigma = usual / log_uniform(rng, *SNR) * np.sqrt(SHOT * seen / usual + 1 - SHOT)
    noise = rng.standard_normal(seen.shape) + 1j * rng.standard_normal(seen.shape)
    burst = Burst.from_arrays(
        real + 1j * imag + sigma * noise,
        offset_px=g.offset_px, pitch_mm=0.1, modulation_hz=MODULATION_HZ,
    )  # fmt: skip
    real, imag = (bench.truth(one)[0].numpy().astype(np.float64) for one in parts[:2])
    return burst, g.scale, real + 1j * imag


def facts_of(rng: np.random.Generator) -> dict[str, list[Array]]:
    """Return what was told of two phases and of two amplitudes of a burst, the truth behind it."""
    burst, scale, truth = draw_burst(rng)
    told: dict[str, Any] = {}

    def telling(where: Any, name: str) -> Any:
        law = getattr(where, name)

        def kept(*facts: Any) -> Any:
            told.setdefault(name, facts)
            return law(*facts)

        return patch.object(where, name, kept)

    with (
        telling(phasors, "phase_of_both"),
        telling(phasors, "amplitude_of_both"),
        telling(method, "finished"),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        reconstruct(burst, scale, channel="phasor")
    y = told["finished"][0].y
    truth = truth * (np.vdot(burst.amplitude, y) / np.vdot(burst.amplitude, burst.amplitude))
    inner = (slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    wanted = {"phase_of_both": np.angle(truth), "amplitude_of_both": np.abs(truth)}
    return {name: [np.array(f)[inner] for f in (*told[name], wanted[name])] for name in wanted}


def fitted(facts: Sequence[list[Array]], loss_of: Loss) -> tuple[float, ...]:
    """Return the law, a factor and exponents, that makes the mean loss of the bursts least."""
    known = [[torch.tensor(np.log(f.ravel())) for f in one] for one in facts]
    law = torch.zeros(len(known[0]) + 1, dtype=torch.float64, requires_grad=True)
    steps = torch.optim.LBFGS([law], max_iter=STEPS, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        steps.zero_grad()
        of_all = [
            loss_of(n, law[0] + sum(c * f for c, f in zip(law[1:], one, strict=True)))
            for n, one in enumerate(known)
        ]
        total = torch.stack(of_all).mean()
        total.backward()
        return total

    steps.step(loss)
    factor, *exponents = law.detach().numpy()
    return (float(np.exp(factor)), *map(float, exponents))


def best(
    name: str,
    drawn: Sequence[list[Array]],
    law: Callable[..., tuple[Array, Array]],
    apart: Callable[[Array, Array], Array] = np.subtract,
) -> None:
    """Print the number of a law by which its means of bursts are nearest to the truth."""

    def of_means(number: float) -> float:
        with patch.object(opinions, name, number):
            means = [law(*facts[:-1])[0] for facts in drawn]
        left = [
            np.mean(apart(mean, facts[-1]) ** 2) for mean, facts in zip(means, drawn, strict=True)
        ]
        return float(np.mean(np.log(left)))

    number = minimize_scalar(of_means, bounds=(0.0, 1.0)).x
    sys.stdout.write(f"{name} = {number:.2f}\n")


def main() -> None:
    """Print the laws."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--bursts", type=int, default=1200)
    ask.add_argument("--seed", type=int, default=1)
    given = ask.parse_args()
    drawn = [facts_of(np.random.default_rng((given.seed, n))) for n in range(given.bursts)]
    light, phase = ([one[name] for one in drawn] for name in ("amplitude_of_both", "phase_of_both"))
    best("TRUST", light, opinions.amplitude_of_both)
    best("OF_BIAS", phase, opinions.phase_of_both, turned)
    variance("AMPLITUDE_VARIANCE", light, opinions.amplitude_of_both, opinions.facts_of_amplitudes)
    variance("PHASE_VARIANCE", phase, opinions.phase_of_both, opinions.facts_of_phases, turned)


def turned(a: Array, b: Array) -> Array:
    """Return how far phases are apart."""
    return within_half_a_turn(a - b)


def variance(
    name: str,
    drawn: Sequence[list[Array]],
    law: Callable[..., tuple[Array, Array]],
    facts_of: Callable[..., tuple[list[Array], Array]],
    apart: Callable[[Array, Array], Array] = np.subtract,
) -> None:
    """Print the law of the variance of means under which their errors are likeliest."""
    told = [facts_of(*facts[:-1]) for facts in drawn]
    error = [apart(law(*facts[:-1])[0], facts[-1]) for facts in drawn]
    squares = [torch.tensor((e**2 / u).ravel()) for e, (_, u) in zip(error, told, strict=True)]

    def of_tails(n: int, variance: Tensor) -> Tensor:
        tails = torch.log1p(squares[n] * torch.exp(-variance) / TAILS)
        return (variance / 2 + (TAILS + 1) / 2 * tails).mean()

    law_of = fitted([facts for facts, _ in told], of_tails)
    sys.stdout.write(f"{name} = ({', '.join(f'{number:.2f}' for number in law_of)})\n")


if __name__ == "__main__":
    main()
