"""Slanted edges that the default method was not tuned on: everything drawn at random, truth exact.

    python benchmarks/edge_exam.py --set 1 --images 300
    python benchmarks/edge_exam.py --set 1 --families ringing "two halos" --noise 0.005 0.02

Each image draws a family of line spread functions, an angle (1.5 to 14 degrees, one in eight near
45), polarity, orientation, a region of 40x40 to 200x60 pixels, a contrast of 1.2:1 to 100:1, noise
of 0 to 5 % (white, growing with the light, or correlated), 8 bits for a third, a place off the
middle, and for some a slight bend or uneven light. Printed for each family and each other property:
errors of MTF50, how often the 95 % intervals hold the truth, how often the error exceeds 3 stated
standard deviations, refusals, and gross errors (10 % and more) without a warning.
"""

import argparse
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from edge_lenses import Edge, Transform, diffracted, disc, gaussian
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lensshift.evaluation.slanted_edge import measure_edge

Vector = NDArray[np.float64]
Family = Callable[[np.random.Generator, float], Transform]
SHAPES = ((40, 40), (64, 64), (60, 100), (100, 60), (200, 60), (48, 90))
PLACES_CPP = np.array([0.0, 0.1, 0.3])


def two_sided(rng: np.random.Generator, angle: float) -> Transform:
    """Return exponentials to both sides, not alike."""
    left, right = rng.uniform(0.2, 3.0, 2)
    share, sigma = rng.uniform(0.2, 0.8), rng.uniform(0.25, 0.6)

    def transform(f: Vector) -> NDArray[np.complex128]:
        turn = 2j * np.pi * f
        tails = share / (1.0 + turn * right) + (1.0 - share) / (1.0 - turn * left)
        return tails * gaussian(f, sigma)

    return transform


def two_halos(rng: np.random.Generator, angle: float) -> Transform:
    """Return a core, a near halo and a far one."""
    shares, widths = rng.uniform(0.02, 0.12, 2), (rng.uniform(1.5, 4.0), rng.uniform(4.0, 12.0))
    sigma = rng.uniform(0.3, 0.8)

    def transform(f: Vector) -> NDArray[np.complex128]:
        far = [
            share / (1.0 + (2 * np.pi * w * f) ** 2)
            for share, w in zip(shares, widths, strict=True)
        ]
        return ((1.0 - shares.sum()) * gaussian(f, sigma) + sum(far)).astype(complex)

    return transform


def wide_halo(rng: np.random.Generator, angle: float) -> Transform:
    """Return the weak one: a share of 0.1 to 0.3 falls off over 5 px."""
    share, sigma = rng.uniform(0.1, 0.3), rng.uniform(0.3, 0.8)
    return lambda f: (
        (1 - share) * gaussian(f, sigma) + share / (1 + (2 * np.pi * 5.0 * f) ** 2)
    ).astype(complex)


def one_sided_halo(rng: np.random.Generator, angle: float) -> Transform:
    share, width, sigma = rng.uniform(0.03, 0.15), rng.uniform(1.5, 6.0), rng.uniform(0.3, 0.7)
    return lambda f: (1 - share) * gaussian(f, sigma) + share / (1 + 2j * np.pi * width * f)


def ringing(rng: np.random.Generator, angle: float) -> Transform:
    """Return a Gaussian with a bump in its MTF, whose LSF rings."""
    sigma, at, width = rng.uniform(0.5, 0.9), rng.uniform(0.15, 0.35), rng.uniform(0.04, 0.12)
    gain = rng.uniform(0.05, 0.25)

    def bump(f: Vector) -> Vector:
        return np.exp(-0.5 * ((np.abs(f) - at) / width) ** 2)

    zero = bump(np.zeros(1))[0]
    return lambda f: (gaussian(f, sigma) * (1 + gain * (bump(f) - zero))).astype(complex)


def moved_oblique(rng: np.random.Generator, angle: float) -> Transform:
    length, sigma = rng.uniform(1.0, 5.0), rng.uniform(0.25, 0.6)
    seen_px = length * np.cos(angle - rng.uniform(0.0, np.pi))
    return lambda f: (np.sinc(seen_px * f) * gaussian(f, sigma)).astype(complex)


def aberrated(rng: np.random.Generator, angle: float) -> Transform:
    """Return a slit pupil with defocus, coma and spherical aberration, an autocorrelation."""
    cutoff = rng.uniform(0.6, 2.0)
    defocus, coma, spherical = rng.uniform(-0.35, 0.35, 3)
    place = np.linspace(-1.0, 1.0, 401)
    shifts = np.linspace(0.0, 1.0, 201)

    def pupil(x: Vector) -> NDArray[np.complex128]:
        waves = defocus * x**2 + coma * (x**3 - 0.6 * x) + spherical * (x**4 - x**2)
        return np.where(np.abs(x) <= 1.0, np.exp(2j * np.pi * waves), 0.0)

    table = np.empty(shifts.size, dtype=complex)
    for k, s in enumerate(shifts):  # of the cut-off: the pupils overlap over 2 (1 - s)
        x = place * (1.0 - s)
        overlap = pupil(x + s) * np.conj(pupil(x - s))
        table[k] = (1.0 - s) * np.trapezoid(overlap, place) / 2.0

    def transform(f: Vector) -> NDArray[np.complex128]:
        s = np.abs(f) / cutoff
        real = np.interp(s, shifts, table.real, right=0.0)
        turned = np.sign(f) * np.interp(s, shifts, table.imag, right=0.0)
        return real + 1j * turned

    return transform


def moffat(rng: np.random.Generator, angle: float) -> Transform:
    width = rng.uniform(0.2, 0.8)
    sigma = rng.uniform(0.2, 0.5)

    def transform(f: Vector) -> NDArray[np.complex128]:
        x = 2 * np.pi * width * np.abs(f)
        return ((1 + x) * np.exp(-x) * gaussian(f, sigma)).astype(complex)

    return transform


def half_filled(rng: np.random.Generator, angle: float) -> Transform:
    """Return diffraction times a disc; the pixel (see `examined`) is filled in part."""
    cutoff, radius = rng.uniform(0.6, 2.0), rng.uniform(0.2, 1.0)
    return lambda f: (diffracted(f, cutoff) * disc(f, radius)).astype(complex)


def two_ghosts(rng: np.random.Generator, angle: float) -> Transform:
    shares, sigma = rng.uniform(0.02, 0.08, 2), rng.uniform(0.3, 0.7)
    away = rng.uniform(-12.0, -2.0), rng.uniform(2.0, 12.0)

    def transform(f: Vector) -> NDArray[np.complex128]:
        both = [
            share * np.exp(-2j * np.pi * f * at) for share, at in zip(shares, away, strict=True)
        ]
        return gaussian(f, sigma) * (1 - shares.sum() + sum(both))

    return transform


def compact(rng: np.random.Generator, angle: float) -> Transform:
    sigma = rng.uniform(0.15, 1.5)
    return lambda f: gaussian(f, sigma).astype(complex)


FAMILIES: dict[str, Family] = {
    "two-sided": two_sided,
    "two halos": two_halos,
    "halo 0.1-0.3": wide_halo,
    "one-sided halo": one_sided_halo,
    "ringing": ringing,
    "oblique motion": moved_oblique,
    "aberrated": aberrated,
    "moffat": moffat,
    "half-filled": half_filled,
    "two ghosts": two_ghosts,
    "compact": compact,
}


def picture(number: int, asked: argparse.Namespace) -> tuple[Edge, Vector, dict[str, Any]]:
    """Return an edge, its image and what was drawn."""
    rng = np.random.default_rng([asked.set, number, 77])
    family = asked.families[number % len(asked.families)]
    steep = number % 8 == 7
    degrees = float(rng.uniform(40.0, 45.0) if steep else rng.uniform(1.5, 14.0))
    angle = float(np.deg2rad(degrees) * rng.choice([-1, 1]))
    fill = float(rng.uniform(0.5, 0.8)) if family == "half-filled" else 1.0
    edge = Edge(FAMILIES[family](rng, angle), angle, fill)
    rows, cols = SHAPES[rng.integers(len(SHAPES))]
    noise = float(rng.choice(asked.noise))
    kind = str(rng.choice(["white", "shot", "correlated"], p=[0.5, 0.25, 0.25]))
    ratio = float(np.exp(rng.uniform(np.log(1.2), np.log(100.0))))
    off = float(rng.uniform(-1.0, 1.0) * 0.2 * cols)
    bend_px = float(rng.uniform(0.05, 0.4)) if rng.random() < 0.2 else 0.0
    light = rng.uniform(-0.08, 0.08, 2) if rng.random() < 0.2 else np.zeros(2)
    row, col = (np.arange(n) - (n - 1) / 2 for n in (rows, cols))
    down = row[:, None] / row[-1]
    normal = col * np.cos(angle) + row[:, None] * np.sin(angle) - off * np.cos(angle)
    normal -= bend_px * (1.5 * down**2 - 0.5)
    image = edge.response(normal)
    if rng.integers(2):
        image = 1.0 - image
    bright = 0.8
    dark = bright / ratio
    signal = (dark + (bright - dark) * image) * (1 + light[0] * down + light[1] * col / col[-1])
    grain = rng.standard_normal(image.shape)
    if kind == "correlated":
        grain = gaussian_filter(grain, rng.uniform(0.4, 1.0), mode="wrap")
        grain /= grain.std()
    if kind == "shot":
        grain *= np.sqrt((0.1 * bright + signal) / (0.6 * bright))
    values = signal + noise * (bright - dark) * grain
    bits = 8 if rng.random() < 1 / 3 else 0
    if bits:
        values = np.rint(np.clip(255 * values, 0, 255))
    if rng.integers(2):
        values = values.T.copy()
    drawn = {"family": family, "degrees": degrees, "noise": noise, "grain": kind, "bits": bits}
    drawn |= {"shape": f"{rows}x{cols}", "ratio": ratio, "off": off, "bend": bend_px > 0}
    return edge, values, drawn | {"light": bool(light.any()), "steep": steep}


def examined(number: int, asked: argparse.Namespace) -> dict[str, Any]:
    """Return what was drawn and what was measured."""
    edge, values, row = picture(number, asked)
    row |= {"number": number, "told": [], "refused": ""}
    start = time.process_time()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            found = measure_edge(
                values, region=(0, values.shape[0], 0, values.shape[1]), frequency_lpmm=PLACES_CPP
            )
        except ValueError as problem:
            return row | {"refused": str(problem)}
    row["told"] = [str(one.message) for one in told]
    half, truth, curve = found.mtf50_lpmm, edge.mtf50(), edge.mtf(PLACES_CPP)
    low, high = np.asarray(found.low), np.asarray(found.high)
    row |= {"error": half.value / truth - 1, "truth": truth, "usable": found.usable}
    row |= {"std": (half.high - half.low) / 3.92 / truth}
    row |= {"covered": [half.low <= truth <= half.high, *((low <= curve) & (curve <= high))[1:]]}
    at = found.mtf.modulation - curve
    row |= {"at": at[1:], "at_std": (high - low)[1:] / 3.92}
    return row | {"spent_s": time.process_time() - start}


def table(rows: Sequence[dict[str, Any]], by: str) -> None:
    """Print a line for each value of a property."""
    for value in dict.fromkeys(sorted(str(row[by]) for row in rows)):
        here = [row for row in rows if str(row[by]) == value]
        good = [row for row in here if not row["refused"] and row["usable"]]
        unusable = sum(1 for row in here if not row["refused"]) - len(good)
        if not good:
            print(f"  {value:<16} {len(here):4d}, none usable")
            continue
        error = np.array([row["error"] for row in good])
        std = np.array([row["std"] for row in good])
        beyond = np.abs(error) > 3.0 * std
        covered = 100.0 * np.mean([row["covered"] for row in good], axis=0)
        gross = sum(not row["told"] and not abs(row["error"]) < 0.1 for row in good)
        refused = sum(bool(row["refused"]) for row in here)
        median, rms = np.sqrt([np.nanmedian(error**2), np.nanmean(error**2)])
        print(
            f"  {value:<16} {len(here):4d} {refused:4d} {unusable:4d}"
            f"  {100 * median:6.2f} {100 * rms:6.2f} {100 * np.nanmean(error):+6.2f}"
            f"   {covered[0]:5.1f} {covered[1]:5.1f} {covered[2]:5.1f}"
            f"   {100 * np.mean(beyond):5.1f}   {gross:3d}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--set", type=int, default=1, help="seed: tune on one, report another")
    parser.add_argument("--images", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument(
        "--noise", nargs="+", type=float, default=[0.0, 0.002, 0.005, 0.01, 0.02, 0.05]
    )
    parser.add_argument("--worst", type=int, default=12, help="print that many of the worst images")
    asked = parser.parse_args()
    rows = [examined(k, asked) for k in range(asked.first, asked.first + asked.images)]
    print("                   number, refused, unusable; MTF50 median, rms, bias in %;")
    print("                   MTF50, MTF at 0.1, 0.3 c/px covered; > 3 std; gross and untold")
    for by in ("family", "noise", "grain", "bits", "shape", "bend", "light", "steep"):
        print(by)
        table(rows, by)
    for row in rows:
        if row["refused"]:
            print(f"refused {row['number']}: {short(row)}: {row['refused'][:90]}")
    good = [row for row in rows if not row["refused"] and row["usable"]]
    for row in sorted(good, key=lambda one: -abs(one["error"]) / one["std"])[: asked.worst]:
        at = row["at"] / row["at_std"]
        told = "; ".join(one.partition(": ")[2][:50] for one in row["told"])
        print(
            f"{row['number']:4d} {short(row)}: {100 * row['error']:+.2f} % of {row['truth']:.3f}, "
            f"{row['error'] / row['std']:+.1f} std, at 0.1 {at[0]:+.1f}, at 0.3 {at[1]:+.1f}; "
            f"{told}"
        )
    spent_s = [row["spent_s"] for row in rows if not row["refused"]]
    print(
        f"median {np.median(spent_s):.3f} s, 95 % within {np.quantile(spent_s, 0.95):.3f} s of CPU"
    )


def short(row: dict[str, Any]) -> str:
    words = [row["family"], f"{row['degrees']:.1f} deg", row["shape"], f"{100 * row['noise']:g} %"]
    words += [row["grain"], f"{row['ratio']:.1f}:1", f"off {row['off']:+.0f}"]
    words += [name for name in ("bits", "bend", "light") if row[name]]
    return " ".join(words)


if __name__ == "__main__":
    main()
