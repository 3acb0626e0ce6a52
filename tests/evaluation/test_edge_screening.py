"""What does not belong to an edge: hot pixels, second edges, mere noise, grey levels."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from lensshift.core.errors import QualityWarning
from lensshift.evaluation.slanted_edge import measure_edge
from lensshift.evaluation.slanted_edge.checks import doubted
from lensshift.evaluation.slanted_edge.noise_model import noise_of_covariance

Image = NDArray[np.float64]
pytestmark = pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
SHAPE = (47, 61)


def step(place_px: float, sigma_px: float = 0.6) -> Image:
    row, col = (np.arange(n) - (n - 1) / 2 for n in SHAPE)
    normal = col * np.cos(0.1) + row[:, None] * np.sin(0.1) - place_px
    return np.asarray(ndtr(normal / sigma_px))


def noisy(image: Image, noise: float, seed: int = 4) -> Image:
    return image + noise * np.random.default_rng(seed).standard_normal(SHAPE)


HOT = np.random.default_rng(7).random(SHAPE) < 0.003


@pytest.mark.parametrize(
    ("out", "level"),
    [
        (HOT, 1.4),
        (np.s_[20:24, 40:44], 0.6),
        (np.s_[5:11, 28:34], -0.4),  # on the edge, where a bend is the first thought
        (np.s_[14:20, 26:34], 1.8),
    ],
)
def test_pixels_that_stand_out_do_not_move_the_result(out: Image, level: float) -> None:
    image = noisy(step(0.3), 0.01)
    spoiled = image.copy()
    spoiled[out] = level
    clean = measure_edge(image).mtf50_lpmm
    with pytest.warns(QualityWarning, match=r"\d+ pixels stand out"):
        found = measure_edge(spoiled)
    assert found.usable
    half_width = 0.5 * (clean.high - clean.low)
    assert abs(found.mtf50_lpmm.value - clean.value) < 0.3 * half_width
    assert found.mtf50_lpmm.high - found.mtf50_lpmm.low < 2.6 * half_width


@pytest.mark.parametrize("columns", [[22, 35], [0, 50], [33, 34]])
@pytest.mark.parametrize("level", [0.0, 1.3])
def test_dead_columns_do_not_move_the_result(columns: list[int], level: float) -> None:
    """They are more than chance explains; MTF50 was up to 170 % off, or a second edge was seen."""
    image = noisy(step(0.3), 0.01)
    spoiled = image.copy()
    spoiled[:, columns] = level
    clean = measure_edge(image).mtf50_lpmm
    with pytest.warns(QualityWarning, match=f"{2 * SHAPE[0]} pixels stand out"):
        found = measure_edge(spoiled, region=(0, SHAPE[0], 0, SHAPE[1]))
    assert found.usable
    assert abs(found.mtf50_lpmm.value - clean.value) < 0.5 * (clean.high - clean.low)


@pytest.mark.parametrize("place", [0.25, 0.3])
def test_where_three_areas_meet_there_is_no_edge_to_use(place: float) -> None:
    """A quarter of the pixels and more was left out, and MTF50 was 0.27 and 1.46 for 0.33."""
    rng = np.random.default_rng(round(20 * place) - 4)
    row, col = np.mgrid[:64, :64].astype(float)
    right = (col - 32) * np.cos(0.2) + (row - 32) * np.sin(0.2) > 0
    light = 0.2 + 0.3 * right + 0.3 * (right & (row > 0.3 * col + 64 * place))
    image = gaussian_filter(light, 0.6) + 0.003 * rng.standard_normal(light.shape)
    found = measure_edge(image, region=(0, 64, 0, 64))
    assert not found.usable
    assert any("something else" in note for note in found.notes)


def test_a_computed_plateau_is_not_clipped() -> None:
    """Of motion the plateaus are level to the last digits, some of which differ."""
    row, col = (np.arange(n) - (n - 1) / 2 for n in SHAPE)
    normal = col * np.cos(0.1) + row[:, None] * np.sin(0.1)
    image = 0.1 + 0.7 * (0.5 + np.clip(normal / 4.0, -0.5, 0.5))
    image += 1e-16 * np.random.default_rng(1).integers(-2, 3, SHAPE)
    assert not any("clipped" in note for note in measure_edge(image).notes)


def test_plateaus_without_noise_are_no_dead_columns() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert measure_edge(100.0 + np.rint(4000.0 * step(0.3))).usable


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (step(-3.0) - step(3.0), "a second one"),
        (step(-1.5) - step(1.5), "a second one"),
        (step(-10.0) - step(10.0), "a second one"),
        (step(-10.0) + step(10.0), "a second one"),
        (np.zeros(SHAPE), "expected an edge, got noise"),
    ],
)
def test_what_is_not_one_edge_is_refused(image: Image, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        measure_edge(noisy(image, 0.01), region=(0, SHAPE[0], 0, SHAPE[1]))


@pytest.mark.parametrize("level", [0.1, 1.0 / 3.0, 7.0])
def test_a_level_that_has_no_exact_mean_is_flat(level: float) -> None:
    flat = np.full(SHAPE, level)
    with pytest.raises(ValueError, match="found no slanted edge"):
        measure_edge(flat)
    with pytest.raises(ValueError, match="a flat region"):
        measure_edge(flat, region=(0, SHAPE[0], 0, SHAPE[1]))


@pytest.mark.parametrize("noise", [0.0, 0.25, 0.45])
@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_neighbouring_grey_levels_do_not_stand_out(noise: float, gamma: float) -> None:
    """Of 22 levels across an edge the second next was dust; gamma makes steps uneven."""
    for seed in range(4):
        rounded = np.rint(100.0 + 22.3 * noisy(step(0.3), noise / 22.3, seed))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            measure_edge((rounded / 130.0) ** gamma, region=(0, 47, 0, 61))
        assert not any("stand out" in str(one.message) for one in caught)


def test_grey_levels_are_not_taken_for_clipping() -> None:
    fine = noisy(step(0.3), 0.0005)
    counts = np.round(150.0 * fine + 40.0)
    assert not any("clipped" in note for note in measure_edge(counts).notes)
    # Quiet dark pixels beside noisy bright ones: one in 13 lies at the lowest level.
    sigma = 0.35 + 5.0 * step(0.3)
    quiet = np.round(40.0 + 150.0 * step(0.3) + sigma * noisy(np.zeros(SHAPE), 1.0))
    assert not any("clipped" in note for note in measure_edge(quiet).notes)
    bright = np.round(230.0 * noisy(step(0.3), 0.01) + 40.0)
    with pytest.warns(QualityWarning, match="bright pixels are clipped at 255"):
        assert not measure_edge(np.clip(bright, 0.0, 255.0)).usable


@pytest.mark.parametrize("top", [255, 511, 4095, 65535])
def test_the_end_of_any_range_of_numbers_is_known(top: int) -> None:
    """Of numbers, and of shares of the largest: noise below a step leaves other levels frequent."""
    image = np.rint(np.minimum((0.2 + 0.9 * noisy(step(0.3), 0.3 / top)) * top, top))
    for values in (image, image / top):
        with pytest.warns(QualityWarning, match="bright pixels are clipped at"):
            assert not measure_edge(values).usable
    below = np.rint(np.minimum((0.2 + 0.9 * noisy(step(0.3), 0.3 / top)) * top, 0.9 * top))
    assert not any("clipped" in note for note in measure_edge(below).notes)


@pytest.mark.parametrize(("seed", "whole"), [(1, False), (2, True)])
def test_few_pixels_of_an_overshoot_that_is_cut_off_are_told(seed: int, whole: bool) -> None:
    """Sharpened by a mask of 1.2 px: what lies beyond the bright level is lost, 3 % of its side."""
    sharpened = 1.7 * step(0.3) - 0.7 * step(0.3, np.hypot(0.6, 1.2))
    values = 60.0 + 188.0 * noisy(sharpened, 0.008, seed)
    values = np.round(values) if whole else values
    cut = measure_edge(np.minimum(values, 255.0))
    assert not cut.usable
    assert any("clipped at 255" in note for note in cut.notes)
    assert not any("clipped" in note for note in measure_edge(values).notes)


def test_levels_that_no_pixel_shows_are_doubted() -> None:
    """Of a halo over half of the region they lie a little beyond; uneven light can fake more."""
    wide = noisy(0.9 * step(0.3) + 0.1 * step(0.3, 12.0), 0.002)
    found = measure_edge(wide)
    assert found.usable
    for dark, bright in ((found.dark - 0.3, found.bright), (found.dark, found.bright + 0.3)):
        moved = replace(found, dark=dark, bright=bright)
        told = doubted(moved, lines=47, gap_px=0.0, values=wide.ravel())
        assert not told.usable
        assert any("beyond all pixels" in note for note in told.notes)


def test_a_prediction_leaves_the_plateaus_their_level() -> None:
    """The sum of a moving mean's prediction tends to 1: a constant would be whitened away."""
    lag = np.abs(np.arange(-3, 4))
    smooth = np.exp(-0.5 * (np.hypot(lag[:, None], lag) / 3.0) ** 2)
    assert noise_of_covariance(smooth, 1.0).prediction.sum() <= 0.8 + 1e-12


def test_light_that_falls_towards_the_corners_is_not_blur() -> None:
    row, col = (2.0 * np.arange(n) / (n - 1) - 1.0 for n in SHAPE)
    light = 1.0 - 0.2 * (col**2 + row[:, None] ** 2)
    even = measure_edge(noisy(0.2 + step(0.3), 0.005)).mtf50_lpmm
    found = measure_edge(noisy(light * (0.2 + step(0.3)), 0.005)).mtf50_lpmm
    assert found.value == pytest.approx(even.value, rel=0.012)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (0.2 + step(0.3, 18.0), "no plateau is seen"),
        (0.2 + (step(0.3) > 0.5), "2 levels only"),
        (-0.2 - step(0.3), "not positive"),
    ],
)
def test_an_edge_that_tells_no_profile_is_named_and_not_used(image: Image, message: str) -> None:
    noise = 0.0 if "levels only" in message else 0.005
    found = measure_edge(noisy(image, noise), region=(0, SHAPE[0], 0, SHAPE[1]))
    assert not found.usable
    assert any(message in note for note in found.notes)


@pytest.mark.parametrize(("apart_px", "share"), [(5, 0.5), (6, 0.3), (11, 0.4), (17, 0.3)])
def test_an_edge_seen_double_is_not_used(apart_px: float, share: float) -> None:
    """Its MTF50 was 70 to 90 % too low; doubled in equal parts, there was not a word."""
    for noise in (0.002, 0.03):
        image = (1.0 - share) * step(-4.0) + share * step(apart_px - 4.0)
        found = measure_edge(0.2 + noisy(image, noise), region=(0, SHAPE[0], 0, SHAPE[1]))
        assert not found.usable
        told = " ".join(found.notes)
        assert float(told.split("rises twice, ")[1].split(" px")[0]) == pytest.approx(apart_px, 0.1)


@pytest.mark.parametrize("blur_px", [1.0, 4.0])
def test_a_ghost_a_long_tail_and_a_shaken_picture_are_blur(blur_px: float) -> None:
    """Also where light gathers at both ends of the blur, as of a lens that swings."""
    turn = np.pi * (np.arange(400) + 0.5) / 400
    shaken = np.mean([step(blur_px * float(x)) for x in np.cos(turn)], axis=0)
    ghost = 0.9 * step(-2.0) + 0.1 * step(8.0)
    tail = np.mean([step(-blur_px * float(np.log(x / np.pi)) - 4.0) for x in turn], axis=0)
    for image in (shaken, ghost, tail):
        for noise in (0.002, 0.06):
            found = measure_edge(0.2 + noisy(image, noise), region=(0, SHAPE[0], 0, SHAPE[1]))
            assert not any("rises twice" in note for note in found.notes)
            assert found.usable


@pytest.mark.parametrize("dark", [40.25, 40.75])
def test_the_rarer_number_of_a_plateau_counts_as_its_share(dark: float) -> None:
    """Noise of 0.3 steps: four in five pixels are rounded down, and the level is nearer to them."""
    counts = np.rint(dark + 100.0 * step(0.3) + noisy(np.zeros(SHAPE), 0.3))
    found = measure_edge(counts, region=(0, SHAPE[0], 0, SHAPE[1]))
    assert found.dark == pytest.approx(dark, abs=0.08)  # rounding alone may be off by 0.054


@pytest.mark.parametrize("counts", [60, 200])
def test_whole_numbers_without_noise_are_believed_as_far_as_they_go(counts: int) -> None:
    """All pixels of a plateau share one error of rounding, which no number of them averages out."""
    exact = measure_edge(10.0 + counts * step(0.3, 1.1)).mtf50_lpmm.value
    rng = np.random.default_rng(counts)
    inside = 0
    for _ in range(6):
        image = 10.0 + rng.random() + counts * step(float(rng.uniform(-1, 1)), 1.1)
        half = measure_edge(np.rint(image)).mtf50_lpmm
        inside += half.low <= exact <= half.high
        assert half.value == pytest.approx(exact, rel=1.0 / counts)
    assert inside >= 5


@pytest.mark.parametrize("rows", [(2, 70), (9, 88), (20, 98)])
def test_a_corner_within_the_region_does_not_move_the_result(rows: tuple[int, int]) -> None:
    """It gave an MTF50 6 % low, outside of its interval, with a bend as the only remark."""
    row, col = (np.arange(n) - (n - 1) / 2 for n in (100, 90))
    across = col * np.cos(0.1) + row[:, None] * np.sin(0.1) + 20.0
    along = row[:, None] * np.cos(0.1) - col * np.sin(0.1)
    square = 0.8 - 0.6 * ndtr(across / 0.8) * ndtr((35.0 - np.abs(along)) / 0.8)
    square += 0.003 * np.random.default_rng(8).standard_normal(square.shape)
    found = measure_edge(square, region=(*rows, 5, 45))
    truth = np.sqrt(np.log(2.0) / 2.0) / np.pi / 0.8  # of a Gaussian: exp(-2 (pi s f)^2) = 1/2
    assert found.usable
    assert abs(found.mtf50_lpmm.value / truth - 1.0) < 0.01
    assert found.mtf50_lpmm.low < truth < found.mtf50_lpmm.high


@pytest.mark.parametrize("seed", [3, pytest.param(8, marks=pytest.mark.slow)])
def test_two_sides_of_a_square_are_not_one_edge(seed: int) -> None:
    """A corner of 90 degrees in the region read 0.41 for 0.28 cycles per pixel, as a bend."""
    row, col = np.arange(45) - 15.5, np.arange(36)[None] + 14.5
    row = row[:, None] + 16.0
    across = col * np.cos(0.105) + row * np.sin(0.105)
    along = row * np.cos(0.105) - col * np.sin(0.105)
    square = ndtr((30.0 - across) / 0.65) * ndtr((30.0 - along) / 0.65)
    image = 200.0 - 150.0 * square + np.random.default_rng(seed).standard_normal(square.shape)
    found = measure_edge(image, region=(0, 45, 0, 36))
    assert not found.usable
    one_side = measure_edge(image[:22], region=(0, 22, 0, 36))
    assert one_side.usable
    assert one_side.mtf50_lpmm.value == pytest.approx(0.187 / 0.65, rel=0.03)  # of the Gaussian


@pytest.mark.parametrize("sigma_px", [0.9, 1.2])
def test_neighbours_foretell_smooth_noise_as_well_as_their_sum_allows(sigma_px: float) -> None:
    """The best factors were all cut alike: innovations were half as large again, and not white."""
    lags = np.arange(-7, 8)
    shared = np.exp(-(lags**2) / (4.0 * sigma_px**2))
    factors = noise_of_covariance(np.outer(shared, shared), 1.0).prediction
    assert factors.sum() == pytest.approx(0.8)
    place = np.array([(r, c) for r in range(-3, 1) for c in range(-3, 4) if (r, c) <= (0, 0)])
    apart = np.sum((place[:, None] - place) ** 2, axis=2)
    covariance = np.exp(-apart / (4.0 * sigma_px**2)) + 1e-4 * np.eye(len(place))
    around, right = covariance[:-1, :-1], covariance[:-1, -1]
    best = np.linalg.solve(around, right)

    def left(used: Image) -> float:
        whitened = np.append(-used, 1.0)
        return float(whitened @ covariance @ whitened)

    assert left(best) < left(factors) < 0.95 * left(best * 0.8 / best.sum())
