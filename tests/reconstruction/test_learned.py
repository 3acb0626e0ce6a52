"""The learned solver: laws that it obeys by construction, and worlds it was not trained on."""

import hashlib
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mosaic import MARGIN_PX, SAMPLES, canvas, mosaic_burst, observe, phasor_mosaic, square

from lensshift import Burst, ShiftField, reconstruct
from lensshift.core.types import Status
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.reconstruction.learned import convolution, kernels, method, network, priors, solver
from lensshift.reconstruction.learned.chain import State
from lensshift.reconstruction.learned.method import auto, status_of
from lensshift.reconstruction.learned.noise import noise_of
from lensshift.reconstruction.learned.solver import Asked
from lensshift.reconstruction.learned.turn import Turn
from lensshift.reconstruction.method import Request
from lensshift.reconstruction.problem import make_problem

BOX_PX = 1 / np.sqrt(12)
INNER = (slice(4, -4), slice(4, -4))
SQUARE_PX = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)])


def solved(burst, *, a=1.0, b=0.0, sigma=None):
    model = forward_model(
        burst.y.shape[1:], burst.scale, burst.offset_px, blur=GaussianBlur(BOX_PX)
    )
    noise = np.full(burst.y.shape, burst.sigma) if sigma is None else sigma
    return solver.solve(model, a * burst.y + b, a * noise, blur_px=BOX_PX)


def error_of(burst, solution):
    return (solution.image - burst.truth)[INNER]


@pytest.mark.parametrize(("a", "b"), [(1.0, 290.0), (4000.0, -17.0), (1e-6, 0.0), (-1.0, 0.5)])
def test_level_and_contrast_mean_nothing(a, b):
    burst = mosaic_burst(1)
    plain = solved(burst)
    other = solver.solve(
        forward_model(burst.y.shape[1:], 2, burst.offset_px, blur=GaussianBlur(BOX_PX)),
        a * burst.y + b, np.full(burst.y.shape, abs(a) * burst.sigma), blur_px=BOX_PX,
    )  # fmt: skip
    if a > 0:
        assert np.abs((other.image - b) / a - plain.image).max() < 0.01 * plain.std.min()
        np.testing.assert_allclose(other.std / a, plain.std, rtol=1e-3)
    else:  # nothing forces a negative to mirror its positive, but training showed both
        assert np.sqrt(np.mean((((other.image - b) / a - plain.image) / plain.std) ** 2)) < 1


@pytest.mark.parametrize("turn_rad", [0.9, -2.5])
def test_turned_phasors_give_the_turned_picture(turn_rad):
    burst, turn = phasor_mosaic(3, (13, 18)), np.exp(1j * turn_rad)
    model = forward_model((13, 18), 2, burst.offset_px, blur=GaussianBlur(BOX_PX))
    asked = [Asked(model, z * burst.y, np.full(burst.y.shape, burst.sigma), BOX_PX)
             for z in (1.0, turn)]  # fmt: skip
    plain, turned = solver.solve_together(asked)
    np.testing.assert_allclose(turned.image / turn, plain.image, atol=0.01 * burst.sigma)
    np.testing.assert_allclose(turned.std, plain.std, rtol=1e-2, atol=1e-3)


def test_the_same_burst_gives_the_same_picture():
    burst = mosaic_burst(2)
    np.testing.assert_array_equal(solved(burst).image, solved(burst).image)


@pytest.mark.parametrize("scale", [2, 3])
def test_a_scene_a_whole_pixel_further_is_the_picture_a_pixel_further(scale):
    fine = canvas(np.random.default_rng(4), (24, 30))
    pair = []
    for rows in (0, 1):
        moved = np.roll(fine, (SAMPLES * rows, 0), (0, 1))
        burst = observe(moved, (24, 30), scale=scale, snr=1e6, rng=np.random.default_rng(0))
        pair.append(solved(replace(burst, sigma=0.004)))
    here = (slice(6 * scale, -8 * scale), slice(6, -6))
    there = (slice(7 * scale, -7 * scale), slice(6, -6))
    off = (pair[1].image[there] - pair[0].image[here]) / pair[0].std[here]
    # Pictures are folded 2 x 2, which a shift of an even number of HR pixels does not feel.
    assert np.sqrt(np.mean(off**2)) < (0.02 if scale == 2 else 0.8)


@pytest.mark.parametrize("turn", ["rows", "cols", "transposed"])
def test_a_mirrored_burst_gives_a_mirrored_picture(turn):
    for seed in range(3):
        burst = mosaic_burst(seed, (21, 26))
        plain = solved(burst)
        flip = {
            "rows": lambda x: x[..., ::-1, :],
            "cols": lambda x: x[..., ::-1],
            "transposed": lambda x: np.swapaxes(x, -1, -2),
        }[turn]
        sign = {"rows": [-1, 1], "cols": [1, -1], "transposed": [1, 1]}[turn]
        offset = burst.offset_px * sign
        offset = offset[:, ::-1] if turn == "transposed" else offset
        turned = replace(burst, y=np.ascontiguousarray(flip(burst.y)), offset_px=offset)
        back = flip(solved(turned).image)
        assert np.abs(back - plain.image).max() < 0.01 * plain.std.min()


def test_tiles_are_not_seen(monkeypatch):
    burst = mosaic_burst(3, (70, 41), snr=200)
    whole = solved(burst)
    monkeypatch.setattr(solver, "TILE_HR_PX", 44)
    parts = solved(burst)
    assert np.abs((parts.image - whole.image) / whole.std).max() < 0.01
    np.testing.assert_allclose(parts.weight, whole.weight, atol=0.01)


def test_the_facts_of_an_interlaced_burst_of_square_pixels_are_none():
    """What networks are told besides pictures is how a burst differs from the usual one."""
    np.testing.assert_allclose(solver.facts_of(0.6, 2, 4), [0.0, 0.0, 0.0, 0.5], atol=1e-7)
    ninth = solver.facts_of(1.6, 4, 144)  # nine samples of each HR pixel
    np.testing.assert_allclose(ninth, [1.0, 1.0, np.log(3), 0.1], rtol=1e-6)


@given(st.tuples(st.integers(1, 1500), st.integers(1, 1500)), st.integers(1, 5))
def test_tiles_fill_a_picture_and_none_is_large(shape, scale):
    filled = np.zeros(shape, int)
    for part, inner in solver._tiles(shape, scale):
        filled[inner] += 1
        for seen, own, size in zip(part, inner, shape, strict=True):
            assert seen.stop - seen.start <= np.ceil((640 + 2 * 32) / scale) + 1
            assert seen.start == 0 or own.start - seen.start >= 32 / scale
            assert seen.stop == size or seen.stop - own.stop >= 32 / scale
    assert np.all(filled == 1)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_what_one_half_holds_does_not_cost_the_other(order):
    rng = np.random.default_rng(8)
    smooth, busy = canvas(rng, (20, 24)), rng.random((24 * SAMPLES, 28 * SAMPLES)) > 0.5
    fine = [smooth, busy.astype(float)]
    cut = MARGIN_PX * SAMPLES
    both = np.concatenate(
        [fine[order[0]][:, :-cut], fine[order[1]][:, cut:]], axis=1
    )  # two scenes that meet at a line
    near = 8  # HR pixels by the seam
    part = slice(4, 48 - near) if order[0] == 0 else slice(48 + near, -4)
    inside = slice(4, 48 - near) if order[0] == 0 else slice(near, -4)
    squares = np.zeros(2)
    for seed in range(9, 14):  # noise of its own in each
        alone = observe(smooth, (20, 24), rng=np.random.default_rng(seed))
        mixed = observe(both, (20, 48), rng=np.random.default_rng(seed))
        squares += [
            float(np.mean((solved(b).image - b.truth)[4:-4, p] ** 2))
            for b, p in ((alone, inside), (mixed, part))
        ]
    assert 10 * np.log10(squares[1] / squares[0]) < 0.5


def test_noise_alone_gives_no_structure():
    rng = np.random.default_rng(5)
    burst = mosaic_burst(1, (30, 41))
    flat = replace(burst, y=0.5 + burst.sigma * rng.standard_normal(burst.y.shape))
    found = solved(flat)
    assert found.image.std() < 0.3 * burst.sigma  # the mean of four frames has 0.5
    assert np.mean(np.abs(found.image - 0.5) < 2 * found.std) > 0.9


def random_print(rng, shape, cell):
    """Return a page of letters of 5 x 7 random cells of so many fine samples: no known letters."""
    rows, cols = ((n + 2 * MARGIN_PX) * SAMPLES for n in shape)
    page = np.ones((rows, cols))
    for top in range(3, rows - 8 * cell, 9 * cell):
        for left in range(3, cols - 6 * cell, 7 * cell):
            ink = np.kron(rng.random((7, 5)) < 0.5, np.ones((cell, cell)))
            page[top : top + 7 * cell, left : left + 5 * cell] -= 0.8 * ink
    return page


@pytest.mark.parametrize("snr", [20, 100])
@pytest.mark.parametrize("cell_hr_px", [0.5, 1.0, 1.5, 2.0])
def test_print_is_not_turned_into_other_letters(cell_hr_px, snr):
    """The truth lies in the error bars; cells of half a pixel, which nothing can show, get no more
    contrast than there is, but their bars hold 81 to 86 % only."""
    inside, contrast, odd = [], [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        fine = random_print(rng, (20, 26), round(cell_hr_px * SAMPLES / 2))
        burst = observe(fine, (20, 26), snr=snr, rng=rng)
        found = solved(burst)
        image, std = found.image[INNER], found.std[INNER]
        inside.append(np.mean(np.abs(image - burst.truth[INNER]) < 2 * std))
        contrast.append(image.std() / burst.truth[INNER].std())
        odd.append(np.mean((image > 1 + 3 * std) | (image < 0.2 - 3 * std)))
    assert np.mean(inside) > (0.78 if cell_hr_px < 1 else 0.88)
    assert np.mean(odd) < 0.02
    if cell_hr_px < 1:
        assert np.mean(contrast) < 1.0


def test_data_decide_as_noise_falls():
    """Sixteen frames of a picture that the model describes exactly: nearer with less noise."""
    rng = np.random.default_rng(6)
    row, col = np.mgrid[:36, :44]
    truth = 0.5 + 0.3 * np.sin(0.9 * row) * np.cos(0.7 * col)
    model = forward_model((18, 22), 2, rng.uniform(-0.5, 0.5, (16, 2)), blur=GaussianBlur(0.3))
    errors = []
    for sigma in (1e-2, 1e-3, 1e-4):
        y = model.operator(truth) + sigma * rng.standard_normal((16, 18, 22))
        found = solver.solve(model, y, np.full(y.shape, sigma), blur_px=0.3)
        errors.append(float(np.sqrt(np.mean((found.image - truth)[INNER] ** 2))))
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.01 * 0.6  # of the contrast; what noise is left would allow far less


@pytest.mark.parametrize("spoil", ["dead", "salt"])
def test_pixels_that_lie_are_left_out(spoil):
    burst = mosaic_burst(7, offset_px=np.tile(square(2), (2, 1)))
    clean = np.sqrt(np.mean(error_of(burst, solved(burst)) ** 2))
    bad = np.random.default_rng(1).random(burst.y.shape) < 0.02
    y = np.where(bad, 5.0, burst.y)
    noise = np.where(bad & (spoil == "dead"), np.inf, burst.sigma)
    found = solved(replace(burst, y=y), sigma=noise)
    assert np.sqrt(np.mean(error_of(burst, found) ** 2)) < (1.15 if spoil == "dead" else 2) * clean
    assert found.weight[bad].mean() < 0.3


@pytest.mark.parametrize(("scale", "snr"), [(2, 15), (2, 50), (2, 200), (3, 30), (4, 30)])
def test_the_truth_lies_within_the_error_bars(scale, snr):
    inside = []
    for seed in range(10):
        burst = mosaic_burst(100 + seed, scale=scale, snr=snr)
        found = solved(burst)
        size = np.abs(error_of(burst, found)) / found.std[INNER]
        inside.append([np.mean(size < 1), np.mean(size < 2)])
    one, two = np.mean(inside, axis=0)
    assert 0.6 < one < 0.93
    assert two > 0.93


@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
def test_a_frame_that_may_be_misplaced_is_believed_less():
    gain = []
    for seed in range(4):
        rng = np.random.default_rng(300 + seed)
        steps = rng.integers(-6, 7, (5, 2)) / SAMPLES
        burst = observe(canvas(rng, (21, 26)), (21, 26), offset_px=steps, snr=200, rng=rng)
        turn = rng.uniform(0, 2 * np.pi)
        told = steps + np.outer([0.3, 0, 0, 0, 0], [np.cos(turn), np.sin(turn)])
        errors = []
        for sigma_px in (None, np.outer([0.2, 0.01, 0.01, 0.01, 0.01], [1, 1])):
            given = Burst.from_arrays(burst.y, offset_px=told, pitch_mm=0.1,
                                      offset_sigma_px=sigma_px)  # fmt: skip
            problem = make_problem(given, given.amplitude, 2, blur=GaussianBlur(BOX_PX),
                                   shift_field=None, noise_sigma=burst.sigma)  # fmt: skip
            found = auto(problem, Request()).image * problem.intensity
            errors.append(np.sqrt(np.mean((found - burst.truth)[INNER] ** 2)))
        gain.append(20 * np.log10(errors[0] / errors[1]))
    assert np.mean(gain) > 0.5
    assert min(gain) > -0.5


def _problem(y, **settings):
    burst = Burst.from_arrays(y, offset_px=square(2), pitch_mm=0.1)
    return make_problem(burst, y, 2, blur=GaussianBlur(BOX_PX), shift_field=None,
                        noise_sigma=None, **settings)  # fmt: skip


def test_the_noise_of_a_large_sensor_is_that_of_windows():
    rng = np.random.default_rng(2)
    problem = _problem(mosaic_burst(11, (80, 260), snr=40).y)
    assert noise_of(problem).sigma * problem.intensity == pytest.approx(0.8 / 40.0, rel=0.1)
    flat = replace(problem, y=0.03 * rng.standard_normal(problem.y.shape))
    assert noise_of(flat).sigma == pytest.approx(0.03, rel=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_given_variances_are_the_noise(seed):
    rng = np.random.default_rng(seed)
    burst = mosaic_burst(seed)
    variance = burst.sigma**2 * rng.uniform(0.5, 4, burst.y.shape)
    problem = _problem(burst.y, pixel_variance=variance)
    told = noise_of(problem).sigma / np.sqrt(problem.weight)
    np.testing.assert_allclose(told * problem.intensity, np.sqrt(variance), rtol=1e-6)


@pytest.mark.parametrize(("unit", "level"), [(3.0, 0.0), (0.2, 290.0), (40.0, -7.0)])
def test_noise_that_is_known_is_that_of_the_burst_in_any_unit(unit, level):
    light = np.broadcast_to(np.linspace(1.0, 5.0, 57), (4, 43, 57))
    y = light + 0.05 * np.sqrt(light) * np.random.default_rng(2).standard_normal(light.shape)
    problem = _problem(y)
    told = noise_of(problem).scaled(problem.intensity, problem.level)
    other = replace(problem, y=(y - level) / unit, intensity=unit, level=level)
    recalled = noise_of(other, told).variance((light - level) / unit) * unit**2
    assert told.b > 0
    np.testing.assert_allclose(recalled, told.variance(light), rtol=1e-6)


@pytest.mark.parametrize("seed", range(2))
def test_distances_count_as_the_square_of_the_light_that_brought_them(seed):
    rng = np.random.default_rng(seed)
    y, light = rng.standard_normal((4, 7, 11)), rng.lognormal(0, 2, (4, 7, 11))
    light[:, 2, 3] = 0.0
    problem = _problem(y)
    weight = rng.uniform(0.2, 1.0, y.shape) * (rng.random(y.shape) > 0.1)
    found = replace(problem, weight=weight).with_brightness(-light)  # signs mean nothing
    share = np.minimum(light / np.median(light[(weight > 0) & (light > 0)]), 1.0)
    np.testing.assert_allclose(found.weight, weight * np.maximum(share**2, 1e-4))


def test_distances_that_no_light_brought_count_alike():
    rng = np.random.default_rng(0)
    problem = _problem(rng.standard_normal((4, 7, 11)))
    found = problem.with_brightness(np.zeros((4, 7, 11)))
    np.testing.assert_array_equal(found.weight, problem.weight)


@pytest.mark.parametrize("phasors", [False, True])
def test_what_chance_does_not_explain_widens_the_std(monkeypatch, phasors):
    burst = phasor_mosaic(5, (13, 18)) if phasors else mosaic_burst(5, (13, 18))
    find, found, more = method.find_misfit, [], 0.3 + np.arange(36) / 9
    for unexplained in (0.0, more):
        monkeypatch.setattr(
            method, "find_misfit",
            lambda *given, u=unexplained: replace(find(*given), unexplained=u + np.zeros((26, 36))),
        )  # fmt: skip
        problem = _problem(burst.y)
        noise = np.full(burst.y.shape, burst.sigma / problem.intensity)
        found.append(method.solved(problem, noise, Request())[1])
    plain, wider = found
    assert plain.shape == ((2, 26, 36) if phasors else (26, 36))
    np.testing.assert_allclose(wider**2 - plain**2, more**2 + 0 * plain)


@pytest.mark.parametrize("kind", [1.0, np.exp(0.7j)])
def test_an_error_of_a_shift_is_noise_where_the_frame_is_steep(kind):
    """Of phasors it is half in each component, and 0.02 px of it is usual."""
    row, col = np.mgrid[:7, :10]
    y = kind * np.tile(0.3 * row - 0.2 * col, (4, 1, 1))
    problem = replace(_problem(y), y=y, shift_error_px=np.array([0.0, 0.1, 0.3, 0.0]))
    sigma = np.random.default_rng(1).uniform(0.01, 0.02, y.shape)
    found = method.with_shift_errors(sigma, problem)
    usual, parts = (0.02, 2) if kind != 1.0 else (0.0, 1)
    error_px2 = np.array([0.0, 0.1, 0.3, 0.0])[:, None, None] ** 2 + usual**2
    np.testing.assert_allclose(found**2, sigma**2 + error_px2 * (0.3**2 + 0.2**2) / parts)


def test_a_picture_has_converged_if_the_last_stage_moved_it_by_less_than_its_error_bar():
    one = solver.Solution(np.ones((5, 7)), np.ones((5, 7)), np.ones((1, 5, 7)), 0.99)
    assert status_of(one) is Status.CONVERGED
    assert status_of(replace(one, change=1.01)) is Status.COMPLETE
    image = np.where(np.arange(7) == 3, np.nan, one.image)
    assert status_of(replace(one, image=image)) is Status.NOT_FINITE


@pytest.mark.parametrize(("spread_px", "constant"), [(0.01, False), (0.2, True)])
def test_shifts_that_differ_over_the_sensor_leave_one_number_for_the_noise(spread_px, constant):
    """The law of the noise knows one shift a frame; with others it would take the scene for it."""
    rng, shape = np.random.default_rng(3), (40, 60)
    light = np.broadcast_to(np.linspace(1.0, 5.0, shape[1]), (4, *shape))
    y = light + 0.05 * np.sqrt(light) * rng.standard_normal(light.shape)
    burst = Burst.from_arrays(y, offset_px=SQUARE_PX, pitch_mm=0.1)
    field_px = np.broadcast_to(SQUARE_PX[:, None, None], (4, *shape, 2)).copy()
    field_px[..., 1] += spread_px * np.linspace(-1, 1, shape[1])
    problem = make_problem(
        burst, burst.amplitude, 2, blur=GaussianBlur(BOX_PX), noise_sigma=None,
        shift_field=ShiftField(field_px),
    )  # fmt: skip
    assert (noise_of(problem).b == 0.0) is constant


def test_an_error_bar_is_not_passed_off_as_noise():
    burst = mosaic_burst(12)
    given = Burst.from_arrays(burst.y, offset_px=burst.offset_px, pitch_mm=0.1)
    estimate = reconstruct(given).amplitude
    assert estimate.std is not None
    assert estimate.noise_gain is None


@pytest.mark.parametrize("shape", [(7, 13), (6, 16), (1, 3)])
@pytest.mark.parametrize("last", [False, True])
def test_a_convolution_is_that_of_its_definition(shape, last):
    rng = np.random.default_rng(9)
    x, weight = rng.standard_normal((*shape, 5)), rng.standard_normal((45, 6)) / 7
    margin = np.pad(x, ((1, 1), (1, 1), (0, 0)), mode="edge")
    direct = sum(
        margin[i : i + shape[0], j : j + shape[1]] @ weight[5 * tap : 5 * tap + 5]
        for tap, (i, j) in enumerate(np.ndindex(3, 3))
    )
    points = convolution.transformed(weight.astype(np.float32))
    wide = convolution.with_margin([x.astype(np.float32)])
    found = convolution.convolved(wide, points, shape, last=last)
    if not last:
        direct, border = np.maximum(direct, 0), found.transpose(0, 2, 1, 3).copy()
        border = border.reshape(len(border), -1, 6)
        found = border[1 : shape[0] + 1, 1 : shape[1] + 1].copy()
        border[1 : shape[0] + 1, 1 : shape[1] + 1] = 0
        assert not border.any()
    # Products of tiles round ten times as coarsely as those of pixels, which does not show (below).
    np.testing.assert_allclose(found, direct, atol=2e-5)


def test_channels_that_are_not_those_of_the_weights_are_refused():
    """What is compiled wrote beyond the ends of its arrays."""
    weight = convolution.transformed(np.zeros((9 * 5, 7), np.float32))
    x = convolution.with_margin([np.zeros((7, 13, 6), np.float32)])
    with pytest.raises(ValueError, match="expected 5 channels, got 6"):
        convolution.convolved(x, weight, (7, 13), last=True)


def test_the_picture_does_not_depend_on_the_cores(monkeypatch):
    rng = np.random.default_rng(3)
    weight = convolution.transformed(rng.standard_normal((9 * 5, 7)).astype(np.float32))
    x = convolution.with_margin([rng.standard_normal((37, 90, 5)).astype(np.float32)])
    monkeypatch.setattr(convolution, "STRIP", 24)  # nine strips of one line of tiles
    expected = convolution.convolved(x, weight, (37, 90), last=False)
    monkeypatch.setattr(convolution, "WORTH_THREADS", 1)
    for cores in (2, 4):
        monkeypatch.setattr(convolution, "core_count", lambda cores=cores: cores)
        found = convolution.convolved(x, weight, (37, 90), last=False)
        np.testing.assert_array_equal(found[:38], expected[:38])


@given(
    st.permutations(range(4)),
    st.lists(st.integers(-3, 3), min_size=8, max_size=8),
    st.floats(0.0, 2 * np.pi),
)
def test_the_square_is_known_in_any_order_and_wherever_it_is(order, pixels, angle):
    offset_px = SQUARE_PX[order] + np.reshape(pixels, (4, 2))
    off = 0.059 * np.array([np.cos(angle), np.sin(angle)])

    def on_the_square(offset_px, scale=2):
        return solver.on_the_square(forward_model((5, 7), scale, offset_px))

    assert on_the_square(offset_px)
    assert on_the_square(offset_px + np.outer([1, 0, 0, 0], off))
    assert not on_the_square(offset_px + np.outer([1, 0, 0, 0], 3 * off))
    assert not on_the_square(offset_px[[0, 1, 2, 2]])  # a corner twice
    assert not on_the_square(offset_px, scale=3)
    assert not on_the_square(offset_px[:3])


def test_rounding_does_not_show(monkeypatch):
    burst = mosaic_burst(4, snr=2000.0)
    fast = solved(burst)
    monkeypatch.setattr(network.Network, "__call__", _in_double_precision)
    exact = solved(burst)
    assert np.abs((fast.image - exact.image) / exact.std).max() < 0.01


def _in_double_precision(net, seen, facts):
    gains = np.split(1 + facts @ net.facts + net.gain_offset, 2)
    rows, cols = seen[0].shape[:2]
    x = np.concatenate([part.reshape(rows, cols, -1) for part in seen], axis=2, dtype=np.float64)
    for number, weight in enumerate(net.layers):
        taps = weight.reshape(3, 3, -1, weight.shape[1]).astype(np.float64)
        if number in (1, 2):
            taps *= gains[number - 1][:, None]
        wide = np.pad(x, ((1, 1), (1, 1), (0, 0)), mode="constant" if number else "edge")
        x = sum(wide[i : i + rows, j : j + cols] @ taps[i, j] for i, j in np.ndindex(3, 3))
        x = np.maximum(x, 0) if number + 1 < len(net.layers) else x
    return x.astype(np.float32)


def test_a_damaged_file_of_weights_is_refused(monkeypatch):
    network.learned_weights.cache_clear()
    monkeypatch.setitem(network.WEIGHTS_SHA256, "phasor", hashlib.sha256(b"").hexdigest())
    with pytest.raises(OSError, match="install lensshift again"):
        network.learned_weights("phasor")
    network.learned_weights.cache_clear()


def _shown_and_answered(monkeypatch, prior, channels, kind):
    """Return a random state, what a prior shows its network of it, and what the prior answers."""
    rng, shape, shown = np.random.default_rng(channels), (1, 7, 11), []
    drawn = rng.standard_normal((1, 4, 6, channels))
    drawn[0, :2, :3] *= 20.0  # beyond what a logarithm may be
    pictures = rng.standard_normal((3, *shape))
    if kind is complex:
        pictures = pictures + 1j * rng.standard_normal(pictures.shape)
    sizes = np.exp(rng.standard_normal((3, *shape)))
    sizes[0, 0, 2, 3] = 0.0  # a misfit of none
    state = State(*pictures, *sizes, Turn(False, False, False), kernels.COMPILED)

    def applied(network, seen, state, before, first, facts):
        shown.extend(seen)
        return drawn

    monkeypatch.setattr(priors, "_applied", applied)
    numbers = {"floor": np.array([-1.0, 0.5])}
    one = prior((None, None), numbers)
    x, s, _ = one.improve(0, state, np.zeros(4, np.float32), None)
    # Four channels are a block of 2 x 2 pixels.
    blocks = drawn.reshape(1, 4, 6, -1, 2, 2).transpose(3, 0, 1, 4, 2, 5)
    drawn_hr = blocks.reshape(-1, 1, 8, 12)[:, :, :7, :11]
    return state, shown, (x, s, one.spread(drawn, state)), drawn_hr


def test_a_prior_of_brightness_adds_to_the_picture_what_its_network_says(monkeypatch):
    state, shown, (x, s, spread), said = _shown_and_answered(
        monkeypatch, priors.BrightnessPrior, 12, float
    )
    expected = [state.v, state.v - state.past, 8 * state.gradient, 2 * state.misfit,
                state.noise, state.trusted]  # fmt: skip
    np.testing.assert_allclose(shown, expected)
    np.testing.assert_allclose(x, state.v + said[0])
    np.testing.assert_allclose(s, np.abs(said[1]) + np.exp(-1.0) * state.noise)
    np.testing.assert_allclose(spread[:, 0], np.abs(said[2]) + np.exp(0.5) * state.noise)


def test_a_prior_of_phasors_sees_and_answers_in_units_of_the_light_and_of_the_noise(monkeypatch):
    """What differs around in units of how much it does, sizes as logarithms."""
    state, shown, (x, s, spread), said = _shown_and_answered(
        monkeypatch, priors.PhasorPrior, 24, complex
    )
    v, noise = state.v, state.noise

    def around(picture):
        found = np.empty_like(picture)
        for i, j in np.ndindex(7, 11):
            found[0, i, j] = picture[0, max(i - 4, 0) : i + 5, max(j - 4, 0) : j + 5].mean()
        return found

    a, d = np.hypot(np.abs(v), noise), np.hypot(np.sqrt(around(np.abs(v - around(v)) ** 2)), noise)
    parts = [(v - around(v)) / d, (v - state.past) / d, 8 * state.gradient / d, v / a]
    expected = [
        *(one for z in parts for one in (z.real, z.imag)), np.log(a / noise) / 3,
        np.log(d / noise) / 3, np.log(np.maximum(state.misfit, 1e-6)), noise / state.trusted,
    ]  # fmt: skip
    np.testing.assert_allclose(shown, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(x, v + np.minimum(a, d) * (said[0] + 1j * said[1]))
    s_along, along, across = (noise * np.exp(np.clip(said[n], -12, 12)) for n in (2, 3, 4))
    np.testing.assert_allclose(s, s_along)
    both = 0.95 * np.tanh(said[5])
    np.testing.assert_allclose(spread, np.stack([along, across, both], axis=1))


def _trained(name):
    """Return the PyTorch chain of `training/` with the weights that came with the package."""
    pytest.importorskip("torch", reason="the training extra is not installed")
    sys.path.insert(0, str(Path(__file__).parents[2] / "training"))
    from export import load_exported
    from network import Solver
    from phasor_network import PhasorSolver

    chain = PhasorSolver() if name == "phasor" else Solver()
    load_exported(chain, *network.learned_weights(name))
    return chain.eval()


def _run(chain, model, y, sigma, blur_hr_px):
    import torch
    from bursts import dense_taps
    from network import facts_of

    rows, cols = model.hr_shape
    values = (y[None], np.ones((1, *sigma.shape)), sigma[None],
              dense_taps(model.rows, rows), dense_taps(model.cols, cols))  # fmt: skip
    with torch.no_grad():
        tensors = [torch.tensor(v, dtype=torch.float32) for v in values]
        facts = facts_of(blur_hr_px, model.scale, len(y[0]) if y.ndim == 4 else len(y))
        stages, spread = chain(*tensors, facts, model.scale)
    return stages[-1][0].numpy(), spread[0].numpy()


@pytest.fixture
def unturned(monkeypatch):
    """Let networks look at pictures as they are, as those of PyTorch do."""
    monkeypatch.setattr(solver, "turn_of", lambda offset_px: Turn(False, False, False))


@pytest.mark.parametrize("name", ["brightness", "square"])
def test_it_is_the_chain_that_was_trained(unturned, name):
    chain = _trained(name)
    rng = np.random.default_rng(0)
    scale, offset_px = (3, rng.uniform(-0.5, 0.5, (5, 2))) if name == "brightness" else (
        2, SQUARE_PX + rng.uniform(-0.05, 0.05, (4, 2))
    )  # fmt: skip
    model = forward_model((13, 18), scale, offset_px, blur=GaussianBlur(0.3))
    y = model.operator(rng.random(model.hr_shape))
    y += 0.02 * rng.standard_normal(y.shape)
    sigma = 0.02 * rng.uniform(0.8, 1.2, y.shape)
    found = solver.solve(model, y, sigma, blur_px=0.3)
    image, std = _run(chain, model, y - np.median(y), sigma, 0.3 * scale)
    np.testing.assert_allclose(image + np.median(y), found.image, atol=2e-5)
    np.testing.assert_allclose(solver.STD_SCALE[name] * std, found.std, rtol=1e-3, atol=1e-6)


def test_phasors_run_through_the_chain_that_was_trained(unturned):
    chain = _trained("phasor")
    rng = np.random.default_rng(1)
    model = forward_model((13, 16), 2, rng.uniform(-0.5, 0.5, (5, 2)), blur=GaussianBlur(0.3))
    scene = rng.random(model.hr_shape) * np.exp(2j * np.cumsum(rng.random(model.hr_shape), 0) / 9)
    noise = rng.standard_normal((2, 5, 13, 16))
    y = model.operator(scene) + 0.02 * (noise[0] + 1j * noise[1])
    sigma = 0.02 * rng.uniform(0.8, 1.2, y.shape)
    found = solver.solve(model, y, sigma, blur_px=0.3)
    image, spread = _run(chain, model, np.stack([y.real, y.imag]), sigma, 0.6)
    np.testing.assert_allclose(image[0] + 1j * image[1], found.image, atol=2e-5)
    np.testing.assert_allclose(np.exp(spread[:2]), found.std[:2], rtol=2e-3)
    np.testing.assert_allclose(spread[2], found.std[2], atol=2e-3)
