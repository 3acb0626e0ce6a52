"""Distance of what is hard: dark surfaces, thin poles, things that move; and what is wrong is said.

Scenes are closed forms on 12 x 12 points in each pixel; noise follows the light, and the shifts
are told to 0.02 px. Nothing of the forward model is used.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, zoom

from lensshift import Burst, QualityWarning, reconstruct
from lensshift.core.types import Estimate
from lensshift.core.units import distance_to_phase

Array = NDArray[np.float64]
Scene = Callable[[Array, Array], tuple[Array, Array]]  # reflectance and distance at (row, col)

F_HZ, SHAPE, POINTS = 15e6, (16, 28), 12
PER_M = distance_to_phase(1.0, F_HZ)
OFFSETS = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)])


def card(
    reflectance: float, wall: float, *, near_m: float = 3.2, col: float = 13.7, wide: float = 12.0
) -> Scene:
    """Return a card that leans before a wall, 7.4 pixels high, and another one at the right."""

    def scene(rows: Array, cols: Array) -> tuple[Array, Array]:
        on = (np.abs(rows - 7.6) < 3.7) & (np.abs(cols - col + 0.05 * rows) < wide / 2)
        beside = (np.abs(rows - 6.1 + 0.1 * cols) < 5.3) & (np.abs(cols - 24.3) < 2.1)
        distance_m = np.where(on, near_m + 0.01 * cols, 4.2 + 0.004 * rows)
        distance_m = np.where(beside, 3.7, distance_m)
        return np.where(beside, 0.6, np.where(on, reflectance, wall)), distance_m

    return scene


def pole(col: float) -> Scene:
    """Return a pole of one pixel and of the reflectance of the wall behind it."""

    def scene(rows: Array, cols: Array) -> tuple[Array, Array]:
        on = np.abs(cols - col - 0.03 * rows) < 0.5
        return np.full(on.shape, 0.4), np.where(on, 3.5, 4.0)

    return scene


def seen(scene: Scene, offset_px: Array) -> tuple[Array, Array]:
    """Return reflectance and distance at all points."""
    fine = [(np.arange(n * POINTS) + 0.5) / POINTS - 0.5 for n in SHAPE]
    rows, cols = np.meshgrid(fine[0] - offset_px[0], fine[1] - offset_px[1], indexing="ij")
    return scene(rows, cols)


def mean(values: Array, per_px: int) -> Array:
    """Return the mean of each of `per_px` x `per_px` parts of the pixels."""
    n = POINTS // per_px
    blocks = values.reshape(SHAPE[0] * per_px, n, SHAPE[1] * per_px, n)
    return np.asarray(blocks.mean(axis=3).mean(axis=1))


def means(scene: Scene, offset_px: Array, per_px: int) -> tuple[NDArray[np.complex128], Array]:
    """Return the mean phasor and light of each of `per_px` x `per_px` parts of the pixels."""
    light, distance_m = seen(scene, offset_px)
    phase = distance_to_phase(distance_m, F_HZ)
    z = mean(light * np.cos(phase), per_px) + 1j * mean(light * np.sin(phase), per_px)
    return z, mean(light, per_px)


def taken(scenes: list[Scene], snr: float, seed: int, told: Array = OFFSETS) -> Burst:
    """Return frames, one of each scene; `snr` is that of pixels of median light."""
    rng = np.random.default_rng(seed)
    wrong = 0.02 * rng.standard_normal(OFFSETS.shape)
    frames = [means(s, o, 1) for s, o in zip(scenes, OFFSETS + wrong, strict=True)]
    z, light = (np.stack(part) for part in zip(*frames, strict=True))
    usual = np.median(light[light > 0])
    sigma = usual / snr * np.sqrt(0.1 + 0.9 * light / usual)
    noise = rng.standard_normal((2, *z.shape))
    z = z + sigma * (noise[0] + 1j * noise[1])
    return Burst.from_arrays(z, offset_px=told, pitch_mm=0.1, modulation_hz=F_HZ)


def truth_m(scene: Scene) -> Array:
    z = means(scene, np.zeros(2), 2)[0]
    return np.mod(np.angle(z), 2 * np.pi) / PER_M


def on_card(scene: Scene, dark: float, per_px: int, wide: int) -> NDArray[np.bool_]:
    """Return the parts of pixels that see, with `wide` x `wide` ones around, dark alone."""
    light = mean(seen(scene, np.zeros(2))[0], per_px)
    return np.asarray(binary_erosion(np.abs(light - dark) < 0.01 * dark, np.ones((wide, wide))))


def measured(burst: Burst) -> Estimate:
    found = reconstruct(burst, channel="phasor").distance_m
    assert found is not None
    return found


# Over 192 bursts it is 4.5 mm too near (standard error 0.3), where `std` says 31 mm.
NOT_MET = pytest.mark.xfail(reason="asked, not met", strict=True)
# The default run takes the darkest in much noise and the other in little.
CARDS = [
    pytest.param(0.04, 15.0),
    pytest.param(0.04, 50.0, marks=pytest.mark.slow),
    pytest.param(0.04, 100.0, marks=[pytest.mark.slow, NOT_MET]),
    pytest.param(0.1, 15.0, marks=pytest.mark.slow),
    pytest.param(0.1, 50.0, marks=pytest.mark.slow),
    pytest.param(0.1, 100.0, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("dark", "snr"), CARDS)
def test_a_dark_surface_is_not_drawn_to_the_bright_wall(snr: float, dark: float) -> None:
    errors, own, within = [], [], []
    for seed in range(24):
        # Where a card ends in its pixels draws it by some mm: each burst has its own.
        rng = np.random.default_rng(seed + 1000)
        where = {"near_m": rng.uniform(2.9, 3.3), "col": rng.uniform(13.0, 14.4)}
        scene = card(dark, 0.8, wide=rng.uniform(11.0, 13.0), **where)
        burst = taken([scene] * 4, snr, seed)
        inside = on_card(scene, dark, 2, 9)
        found = measured(burst)
        error = (found.image - truth_m(scene))[inside]
        errors.append(error.mean())
        within.append(np.mean(np.abs(error) < 2 * found.std[inside]))
        # The noise of these frames may happen to draw all that sees the card alone.
        turned = burst.amplitude * np.conj([means(scene, o, 1)[0] for o in OFFSETS])
        own.append(np.angle(turned[:, on_card(scene, dark, 1, 3)].sum()) / PER_M)
    # With hardly any light within the error bars, which are wide, at least.
    allowed = 0.5 * np.median(found.std[inside]) if snr < 20 else 0.0
    bias = np.mean(np.subtract(errors, own))
    assert abs(bias) <= max(2 * np.std(errors, ddof=1) / np.sqrt(24), allowed)
    assert np.mean(within) >= 0.9


@pytest.mark.slow
def test_a_pole_of_one_pixel_is_seen_and_std_says_how_well() -> None:
    """Asked: within 5 cm in 80 % of the lines; a pole between two HR pixels is not."""
    near, within = [], []
    rows, cols = (np.indices((2 * SHAPE[0], 2 * SHAPE[1])) + 0.5) / 2 - 0.5
    for seed in range(24):
        col = 13.5 + np.random.default_rng(seed).uniform(-0.5, 0.5)
        found = measured(taken([pole(col)] * 4, 50.0, seed))
        d, true = found.image, truth_m(pole(col))
        beside = np.abs(cols - col - 0.03 * rows) > 1.0
        within.append(np.mean((np.abs(d - true) < 2 * found.std)[~beside]))
        near.append(np.where(beside, np.inf, d)[6:26].min(axis=1))
    assert abs(np.median(near) - 3.5) < 0.05
    assert np.mean(np.abs(np.concatenate(near) - 3.5) < 0.1) >= 0.7
    assert np.mean(within) >= 0.9


@pytest.mark.parametrize("by_px", [1.0, 3.0, 5.0])
def test_what_moves_is_as_good_as_in_one_frame(by_px: float) -> None:
    still = card(0.25, 0.5, near_m=3.3)
    moved = [card(0.25, 0.5, near_m=3.3, col=13.7 + by_px * k / 3) for k in range(4)]
    burst = taken(moved, 50.0, 1)
    with pytest.warns(QualityWarning, match="something moved"):
        found = measured(burst).image
    true = truth_m(still)
    rows, cols = np.indices(true.shape) / 2
    where = (np.abs(rows - 7.6) < 5.5) & (np.abs(cols - 13.7 - by_px / 2) < 7.5 + by_px / 2)
    one = zoom(np.angle(burst.amplitude[0]) % (2 * np.pi), 2, order=1) / distance_to_phase(1, F_HZ)
    rms = [np.sqrt(np.mean((d - true)[where] ** 2)) for d in (found, one)]
    quiet = measured(taken([still] * 4, 50.0, 1)).image
    rest = [np.sqrt(np.mean((d - true)[~where][4:-4] ** 2)) for d in (found, quiet)]
    assert rms[0] < 0.5 * rms[1]
    assert rest[0] < 1.05 * rest[1]


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 5)), 5]
)
def test_wrong_shifts_are_named_and_right_ones_pass(seed: int) -> None:
    scene = card(0.12 + 0.1 * seed, 0.5, near_m=3.0 + 0.15 * seed)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        measured(taken([scene] * 4, 20.0 + 10 * seed, seed))
    off = OFFSETS.copy()
    off[2, 1] += 1.0
    for told, name in (
        (-OFFSETS, "sign"),
        (OFFSETS[:, ::-1], "rows and columns"),
        (off, "frame 2"),
    ):
        with pytest.warns(QualityWarning, match=name):
            measured(taken([scene] * 4, 20.0 + 10 * seed, seed, told))


@pytest.mark.parametrize("seed", [5, 6])
def test_a_surface_below_much_sky_stays_smooth(seed: int) -> None:
    """Phases of pixels without light are anything, and were the unit of all the others' noise."""

    def scene(rows: Array, cols: Array) -> tuple[Array, Array]:
        lit = rows + 0.5 * np.sin(cols) > 8.6
        return np.where(lit, 0.4, 0.0), 3.6 + 0.02 * cols + 0.01 * rows

    found = measured(taken([scene] * 4, 120.0, seed))
    inside = np.s_[23:-2, 2:-2]
    off_m = (found.image - truth_m(scene))[inside]
    assert np.sqrt(np.mean(off_m**2)) < 0.5 / 120.0 / PER_M  # of one frame; 1.1 before
    assert np.mean(np.abs(off_m) < 2 * found.std[inside]) > 0.8


def test_distances_of_hardly_any_light_spoil_nothing() -> None:
    """The distance channel alone: pixels whose phase is anything count as little as they know."""
    rng = np.random.default_rng(3)
    z = means(card(0.4, 0.5), np.zeros(2), 1)[0]
    frames = np.stack([z] * 4) + 0.005 * rng.standard_normal((4, *SHAPE))
    dark = rng.random(frames.shape) < 0.1
    distance_m = np.mod(np.angle(frames), 2 * np.pi) / PER_M
    anything = np.where(dark, rng.uniform(0, 10, frames.shape), distance_m)
    amplitude = np.where(dark, 0.005, np.abs(frames))
    found = [
        reconstruct(
            Burst.from_arrays(a, d, offset_px=np.zeros((4, 2)), pitch_mm=0.1, modulation_hz=F_HZ),
            1, channel="distance",
        ).distance_m.image
        for a, d in ((np.abs(frames), distance_m), (amplitude, anything))
    ]  # fmt: skip
    truth = np.mod(np.angle(z), 2 * np.pi) / PER_M
    clean, spoilt = (np.sqrt(np.mean((d - truth) ** 2)) for d in found)
    assert spoilt < 1.3 * clean


@pytest.mark.slow
def test_std_of_wide_surfaces_is_that_of_their_errors() -> None:
    """Amplitude and distance of even surfaces, of noise that follows the light, without a bias."""

    def scene(rows: Array, cols: Array) -> tuple[Array, Array]:
        left = cols < 13.4
        return np.where(left, 0.25, 0.6), np.where(left, 3.4, 4.1)

    z = means(scene, np.zeros(2), 2)
    inside = np.zeros((32, 56), bool)
    inside[4:-4, 4:20] = inside[4:-4, 36:-4] = True
    for snr in (15.0, 40.0):
        off = []
        for seed in range(40, 52):
            found = reconstruct(taken([scene] * 4, snr, seed), 2, channel="phasor")
            amplitude, distance = found.amplitude, found.distance_m
            assert amplitude is not None
            assert distance is not None
            off.append([
                (amplitude.image - np.abs(z[0])) / amplitude.std,
                (distance.image - truth_m(scene)) / distance.std,
            ])  # fmt: skip
        sizes = np.array(off)[:, :, inside]
        # Means of some 30 pixels of frames are independent in so few places of each burst.
        assert np.all(np.abs(sizes.mean(axis=(0, 2))) < 3 / np.sqrt(12 * 8))
        share = np.mean(np.abs(sizes) < 2, axis=(0, 2))
        assert share[0] == pytest.approx(0.9545, abs=0.04)
        assert 0.93 < share[1] <= 1.0
