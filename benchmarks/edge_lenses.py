"""Slanted edges of many lenses, exact in Fourier space: errors and coverage of the default method.

python benchmarks/edge_lenses.py --set 1 --images 20 --kinds diffraction halo --noise 0.002 0.01

Every image draws its own lens (cut-off, radius, length, share), angle, place, polarity and noise.
The set is the seed: tune on one, report on another.
"""

import argparse
import time
import warnings
import zlib
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import j1

from lensshift.evaluation.slanted_edge import measure_edge

Vector = NDArray[np.float64]
Transform = Callable[[Vector], NDArray[np.complex128]]
Lens = Callable[[np.random.Generator, float], Transform]

_PERIOD_PX, _FINER = 4096, 128


def gaussian(frequency: Vector, sigma_px: float) -> Vector:
    return np.exp(-2.0 * (np.pi * sigma_px * frequency) ** 2)


def diffracted(frequency: Vector, cutoff_cpp: float) -> Vector:
    u = np.clip(np.abs(frequency) / cutoff_cpp, 0.0, 1.0)
    return 2.0 / np.pi * (np.arccos(u) - u * np.sqrt(1.0 - u * u))


def disc(frequency: Vector, radius_px: float) -> Vector:
    x = 2.0 * np.pi * radius_px * np.abs(frequency) + 1e-12
    return 2.0 * j1(x) / x


def one_sided(frequency: Vector, length_px: float) -> NDArray[np.complex128]:
    """Return the transform of an exponential tail to one side, its mean at 0."""
    turn = 2j * np.pi * frequency * length_px
    return np.exp(turn) / (1.0 + turn)


def of_diffraction(cutoff_cpp: float) -> Lens:
    return lambda rng, angle: lambda f: diffracted(f, cutoff_cpp).astype(complex)


def halo(share: float, length_px: float, sigma_px: float) -> Transform:
    def transform(f: Vector) -> NDArray[np.complex128]:
        wide = 1.0 / (1.0 + (2.0 * np.pi * length_px * f) ** 2)
        return ((1.0 - share) * gaussian(f, sigma_px) + share * wide).astype(complex)

    return transform


def ghost(share: float, away_px: float, sigma_px: float) -> Transform:
    def transform(f: Vector) -> NDArray[np.complex128]:
        return gaussian(f, sigma_px) * (1.0 - share + share * np.exp(-2j * np.pi * f * away_px))

    return transform


def sharpened(gain: float, narrow_px: float, wide_px: float) -> Transform:
    return lambda f: ((1.0 + gain) * gaussian(f, narrow_px) - gain * gaussian(f, wide_px)).astype(
        complex
    )


def moved(length_px: float, sigma_px: float) -> Lens:
    """Return motion across the columns, which the edge's normal sees foreshortened."""
    return lambda rng, angle: (
        lambda f: (np.sinc(length_px * np.cos(angle) * f) * gaussian(f, sigma_px)).astype(complex)
    )


def fixed(transform: Transform) -> Lens:
    return lambda rng, angle: transform


def any_wave(rng: np.random.Generator, angle: float) -> Transform:
    """Return diffraction and a disc, about what a slight defocus makes of it."""
    cutoff_cpp, radius_px = rng.uniform(0.4, 1.6), rng.uniform(0.1, 1.2)
    return lambda f: (diffracted(f, cutoff_cpp) * disc(f, radius_px)).astype(complex)


LENSES: dict[str, Lens] = {
    # One lens each, so that results can be laid beside stored ones of other programs.
    "diffraction1.2": of_diffraction(1.2),
    "diffraction0.6": of_diffraction(0.6),
    "halo5": fixed(halo(0.1, 5.0, 0.4)),
    "ghost10": fixed(ghost(0.1, 10.0, 0.4)),
    "coma2.5": fixed(lambda f: one_sided(f, 2.5) * gaussian(f, 0.3)),
    "sharp": fixed(sharpened(0.4, 0.5, 3.0)),
    "gaussian": fixed(lambda f: gaussian(f, 0.5).astype(complex)),
    "disc3": fixed(lambda f: (disc(f, 3.0) * gaussian(f, 0.3)).astype(complex)),
    "motion3": moved(3.0, 0.3),
    # Families: every image another lens.
    "any diffraction": lambda rng, angle: of_diffraction(rng.uniform(0.35, 2.0))(rng, angle),
    "any halo": lambda rng, angle: halo(
        rng.uniform(0.02, 0.2), rng.uniform(2.0, 12.0), rng.uniform(0.3, 0.8)
    ),
    "any ghost": lambda rng, angle: ghost(
        rng.uniform(0.03, 0.15), rng.choice([-1, 1]) * rng.uniform(3.0, 16.0), rng.uniform(0.3, 0.7)
    ),
    "any coma": lambda rng, angle: (
        lambda tail, sigma: lambda f: one_sided(f, tail) * gaussian(f, sigma)
    )(rng.uniform(0.5, 4.0), rng.uniform(0.25, 0.6)),
    "any sharpening": lambda rng, angle: sharpened(
        rng.uniform(0.2, 1.5), rng.uniform(0.4, 0.6), rng.uniform(0.8, 4.0)
    ),
    "any disc": lambda rng, angle: (
        lambda radius, sigma: lambda f: (disc(f, radius) * gaussian(f, sigma)).astype(complex)
    )(rng.uniform(0.5, 4.0), rng.uniform(0.2, 0.5)),
    "any motion": lambda rng, angle: moved(rng.uniform(1.0, 5.0), rng.uniform(0.2, 0.5))(
        rng, angle
    ),
    "any defocus": any_wave,
    "any veil": lambda rng, angle: (
        lambda share, width, sigma: (
            lambda f: (
                (1.0 - share) * gaussian(f, sigma)
                + share * (1.0 + (2.0 * np.pi * width * f) ** 2) ** -0.75
            ).astype(complex)
        )
    )(rng.uniform(0.03, 0.2), rng.uniform(1.0, 6.0), rng.uniform(0.3, 0.7)),
}


class Edge:
    """An edge of known transform: optics along the normal times the pixel."""

    def __init__(self, optics: Transform, angle_rad: float, side_px: float = 1.0) -> None:
        self.angle_rad = angle_rad

        def whole(frequency: Vector) -> NDArray[np.complex128]:
            across, along = side_px * np.cos(angle_rad), side_px * np.sin(angle_rad)
            return optics(frequency) * np.sinc(across * frequency) * np.sinc(along * frequency)

        self.transform = whole
        # A square wave of a long period: its steps are too far apart to see one another.
        count = _PERIOD_PX * _FINER
        order = np.arange(count // 2 + 1)
        wave = np.zeros(order.size, dtype=complex)
        wave[1::2] = 1.0 / (1j * np.pi * order[1::2])
        spectrum = wave * whole(order / _PERIOD_PX) * count
        spectrum[0] = 0.5 * count
        self._response = np.roll(np.fft.irfft(spectrum, count), count // 2)
        self._start_px = -0.5 * _PERIOD_PX

    def response(self, normal_px: Vector) -> Vector:
        place = (normal_px - self._start_px) * _FINER
        low = np.floor(place).astype(np.intp)
        share, e = place - low, self._response
        return (1.0 - share) * e[low] + share * e[low + 1]

    def mtf(self, frequency: Vector) -> Vector:
        return np.abs(self.transform(np.asarray(frequency, dtype=np.float64)))

    def mtf50(self) -> float:
        frequency = np.arange(16001) * 1e-4
        curve = self.mtf(frequency)
        k = int(np.argmax((curve[:-1] >= 0.5) & (curve[1:] < 0.5)))
        return float(frequency[k] + (curve[k] - 0.5) / (curve[k] - curve[k + 1]) * 1e-4)

    def image(self, shape: tuple[int, int], place_px: float) -> Vector:
        row, col = (np.arange(n) - (n - 1) / 2 for n in shape)
        normal = col * np.cos(self.angle_rad) + row[:, None] * np.sin(self.angle_rad) - place_px
        return self.response(normal)


def drawn(
    kind: str, noise: float, shape: tuple[int, int], rng: np.random.Generator
) -> tuple[Edge, NDArray[np.float64]]:
    """Return an edge of 3 to 15 degrees and its image from 10000 to 50000."""
    angle_rad = np.deg2rad(rng.uniform(3.0, 15.0)) * rng.choice([-1, 1])
    edge = Edge(LENSES[kind](rng, angle_rad), angle_rad)
    image = edge.image(shape, rng.uniform(-1.0, 1.0) * min(2.0, shape[1] / 12))
    image = 1.0 - image if rng.integers(2) else image
    return edge, 1e4 + 4e4 * (image + noise * rng.standard_normal(shape))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", type=int, default=1, help="seed of lenses and noise")
    parser.add_argument("--images", type=int, default=20)
    parser.add_argument("--kinds", nargs="+", choices=LENSES, default=list(LENSES))
    parser.add_argument("--noise", nargs="+", type=float, default=[0.002, 0.01, 0.05])
    parser.add_argument("--shape", nargs=2, type=int, default=(64, 64))
    parser.add_argument("--errors", action="store_true", help="print the error of every image")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    places = np.array([0.0, 0.1, 0.3])
    rows, cols = arguments.shape
    print(
        "lens             noise    rmse    bias  half width  covered MTF50, at 0.1, 0.3"
        "  times sfrmat5"
    )
    for kind in arguments.kinds:
        for noise in arguments.noise:
            rng = np.random.default_rng(
                [arguments.set, zlib.crc32(kind.encode()), int(1e4 * noise)]
            )
            found = []
            for _ in range(arguments.images):
                edge, image = drawn(kind, noise, (rows, cols), rng)
                whole = (0, rows, 0, cols)
                start = time.process_time()
                one = measure_edge(image, region=whole, frequency_lpmm=places)
                middle = time.process_time()
                measure_edge(image, region=whole, method="sfrmat5", order=1)
                spent = (middle - start) / max(time.process_time() - middle, 1e-9)
                half, truth, curve = one.mtf50_lpmm, edge.mtf50(), edge.mtf(places)
                low, high = np.asarray(one.low), np.asarray(one.high)
                inside = (low <= curve) & (curve <= high)
                width = 0.5 * (half.high - half.low) / truth
                covered = half.low <= truth <= half.high
                found.append((half.value / truth - 1, width, covered, *inside[1:], spent))
            values = np.array(found)
            if arguments.errors:
                print(np.array2string(100 * values[:, 0], precision=2))
            error, shares = values[:, 0], values[:, 2:5].mean(axis=0)
            print(
                f"{kind:16s} {noise:5.3f} {100 * np.sqrt(np.mean(error**2)):6.2f} %"
                f" {100 * error.mean():+6.2f} % {100 * np.median(values[:, 1]):8.2f} %"
                f"     {shares[0]:5.2f} {shares[1]:5.2f} {shares[2]:5.2f}"
                f"  {np.median(values[:, 5]):6.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
