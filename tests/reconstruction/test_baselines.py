"""Plain methods: laws that all of them obey, closed forms, and the numbers of the peer study."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lensshift.core.grid import hr_to_lr
from lensshift.core.types import Burst
from lensshift.reconstruction.baselines import accumulate, deconvolve, interpolate
from lensshift.reconstruction.baselines.deconvolve import gaussian_psf
from lensshift.reconstruction.baselines.holes import fill_holes
from lensshift.reconstruction.baselines.result import Baseline
from lensshift.reconstruction.reconstruct import reconstruct

Method = Callable[..., Baseline]


def _whole(method: Method) -> Method:
    """Let a method take lists, and None for frames of which all pixels count."""

    def run(frames: NDArray, weight: NDArray | None, offset_px: object, *more, **settings):
        share = np.ones(frames.shape) if weight is None else weight
        return method(frames, share, np.asarray(offset_px, float), *more, **settings)

    return run


nearest = _whole(lambda *given: interpolate.resampled(*given, interpolate.nearest_taps))
bicubic, deconvolution = _whole(interpolate.bicubic), _whole(deconvolve.deconvolution)
shift_and_add, drizzle_frames = map(_whole, (accumulate.shift_and_add, accumulate.drizzle_frames))

SHAPE, SCALE = (9, 14), 3
OFFSET_PX = np.array([(0.3, -0.2), (-0.45, 0.1), (0.05, 0.6), (-0.7, -1.3), (0.0, 0.0)])


def _one(single: Method, **settings: object) -> Method:
    """Let a method for a single frame take a burst and use its first frame."""

    def run(frames: NDArray, weight: NDArray | None, offset_px: NDArray, scale: int) -> Baseline:
        share = None if weight is None else weight[0]
        return single(frames[0], share, offset_px[0], scale, **settings)

    return run


def _with(many: Method, **settings: object) -> Method:
    return lambda *arguments: many(*arguments, **settings)


METHODS: dict[str, Method] = {
    "nearest": _one(nearest),
    "bicubic": bicubic,
    "bicubic mean": _with(bicubic, combine="mean"),
    "bicubic median": _with(bicubic, combine="median"),
    "deconvolution": _one(deconvolution, psf_sigma_px=0.3, noise_sigma=0.01),
    "unsupervised deconvolution": _one(
        deconvolution, psf_sigma_px=0.3, noise_sigma=0.01, method="unsupervised"
    ),
    "shift and add": shift_and_add,
    "shift and add median": _with(shift_and_add, combine="median"),
    "drizzle": drizzle_frames,
    "drizzle large drops": _with(drizzle_frames, pixfrac=1.0),
    "drizzle points": _with(drizzle_frames, kernel="point"),
}
LINEAR = [name for name in METHODS if name.startswith(("nearest", "bicubic", "shift"))]
LINEAR = [name for name in LINEAR if "median" not in name]
every_method = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
every_linear_method = pytest.mark.parametrize("name", LINEAR)


def random_frames(seed: int, count: int = 5) -> NDArray[np.float64]:
    return np.random.default_rng(seed).random((count, *SHAPE))


def scattered_weight(seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return np.where(rng.random((5, *SHAPE)) < 0.15, 0.0, rng.uniform(0.2, 1.0, (5, *SHAPE)))


def ramp_seen_by_each_frame(row_slope: float, col_slope: float) -> NDArray[np.float64]:
    """Return a scene row_slope * row + col_slope * col whose content moves by the offset."""
    row, col = np.arange(SHAPE[0]), np.arange(SHAPE[1])
    return np.stack(
        [np.add.outer(row_slope * (row - r), col_slope * (col - c)) for r, c in OFFSET_PX]
    )


@every_method
def test_flat_stays_flat_and_the_shape_is_the_frames_times_scale(method: Method) -> None:
    result = method(np.full((5, *SHAPE), 0.7), None, OFFSET_PX, SCALE)
    assert result.image.shape == (27, 42)
    sampled = method is METHODS["unsupervised deconvolution"]  # the mean of a random walk
    np.testing.assert_allclose(result.image, 0.7, atol=1e-3 if sampled else 2e-6)


@every_method
def test_sign_of_the_offset_in_rows_and_columns(method: Method) -> None:
    row, col = (hr_to_lr(np.arange(size * SCALE), SCALE) for size in SHAPE)
    inner = (slice(8, -8), slice(8, -8))
    for slopes in ((0.02, 0.0), (0.0, 0.02)):
        frames = 0.5 + ramp_seen_by_each_frame(*slopes)
        image = method(frames, None, OFFSET_PX, SCALE).image
        ramp = 0.5 + np.add.outer(slopes[0] * row, slopes[1] * col)
        # The mean error sees a wrong sign, whatever the method does within a pixel.
        assert abs(np.mean((image - ramp)[inner])) < 0.02 * 0.2  # LR px
        assert np.std((image - ramp)[inner]) < 0.02 * 0.45


@pytest.mark.parametrize("combine", ["first", "mean", "median"])
def test_bicubic_is_exact_on_ramps(combine: str) -> None:
    row, col = (hr_to_lr(np.arange(size * SCALE), SCALE) for size in SHAPE)
    image = bicubic(ramp_seen_by_each_frame(0.3, -0.2), None, OFFSET_PX, SCALE, combine).image
    expected = np.add.outer(0.3 * row, -0.2 * col)
    np.testing.assert_allclose(image[9:-9, 9:-9], expected[9:-9, 9:-9], atol=1e-12)


@every_method
def test_complex_frames_are_two_real_runs(method: Method) -> None:
    real, imag = random_frames(1), random_frames(2)
    weight = scattered_weight(3)
    result = method(real + 1j * imag, weight, OFFSET_PX, SCALE)
    settings = (weight, OFFSET_PX, SCALE)
    if method is METHODS["deconvolution"]:  # the balance is common to both components
        swapped = method(1j * (real + 1j * imag), *settings)
        np.testing.assert_allclose(swapped.image, 1j * result.image, atol=1e-12)
        return
    expected = method(real, *settings).image + 1j * method(imag, *settings).image
    np.testing.assert_allclose(result.image, expected, atol=1e-12)


@every_method
def test_invalid_pixels_never_leak(method: Method) -> None:
    frames, weight = random_frames(4), scattered_weight(5)
    weight[2] = 0.0  # a whole frame
    weight[0, 2:6, 3:8] = 0.0  # a large hole
    results = []
    for hidden in (np.nan, 1e30, -np.inf):
        frames[weight == 0] = hidden
        results.append(method(frames, weight, OFFSET_PX, SCALE))
    for result in results:
        assert np.isfinite(result.image).all()
        np.testing.assert_array_equal(result.image, results[0].image)
        if result.noise_gain is not None:
            assert np.isfinite(result.noise_gain).all()
    assert results[0].image.min() > -1
    assert results[0].image.max() < 2


@every_method
def test_pixels_beyond_the_burst_are_still_numbers(method: Method) -> None:
    far = OFFSET_PX.copy()
    far[1:4] = [(40.0, 0.0), (0.0, -1e6), (-1e300, 1e300)]
    assert np.isfinite(method(random_frames(6), None, far, SCALE).image).all()


@every_linear_method
def test_noise_gain_is_what_monte_carlo_finds(name: str) -> None:
    rng = np.random.default_rng(7)
    weight = scattered_weight(8)
    if "bicubic" in name:
        weight[weight == 0] = 0.5  # filled LR pixels are taken as independent, so not exact here
    result = METHODS[name](np.zeros((5, *SHAPE)), weight, OFFSET_PX, SCALE)
    trials = np.stack(
        [
            METHODS[name](rng.standard_normal((5, *SHAPE)), weight, OFFSET_PX, SCALE).image
            for _ in range(200)
        ]
    )
    measured = np.sqrt(np.mean(trials**2, axis=0))
    assert result.noise_gain is not None
    assert np.sqrt(np.mean(result.noise_gain**2)) == pytest.approx(
        np.sqrt(np.mean(measured**2)), rel=0.02
    )
    np.testing.assert_allclose(measured, result.noise_gain, rtol=0.2)


def test_the_gain_of_filled_pixels_is_nearly_right_for_bicubic() -> None:
    rng = np.random.default_rng(9)
    weight = scattered_weight(10)
    result = bicubic(np.zeros((5, *SHAPE)), weight, OFFSET_PX, SCALE, "mean")
    trials = [
        bicubic(rng.standard_normal((5, *SHAPE)), weight, OFFSET_PX, SCALE, "mean").image
        for _ in range(100)
    ]
    assert result.noise_gain is not None
    assert np.mean(result.noise_gain) == pytest.approx(np.std(trials), rel=0.1)


@pytest.mark.parametrize("scale", [1, 2, 3])
def test_full_patterns_interlace_exactly(scale: int) -> None:
    fine = np.random.default_rng(11).random((5 * scale, 16 * scale))
    steps = (np.arange(scale) - (scale - 1) / 2) / scale
    offset_px = np.array([(-r, -c) for r in steps for c in steps])
    frames = np.stack([fine[i::scale, j::scale] for i in range(scale) for j in range(scale)])
    for method, tolerance in (
        (shift_and_add, 0.0),
        (_with(shift_and_add, combine="median"), 0.0),
        (_with(drizzle_frames, pixfrac=1 / scale), 1e-6),
    ):
        result = method(frames, None, offset_px, scale)
        np.testing.assert_allclose(result.image, fine, rtol=0, atol=tolerance)


def test_samples_of_one_pixel_are_averaged_by_their_weight() -> None:
    weight = np.ones((3, 2, 2))
    weight[1] = 0.5
    result = shift_and_add(np.stack([np.full((2, 2), v) for v in (1.0, 4.0, 2.0)]), weight,
                           [(0.25, 0.25), (0.25, 0.25), (-0.25, 0.25)], 2)  # fmt: skip
    np.testing.assert_allclose(result.image[:, 0], [2.0, 2.0, 2.0, 2.0])
    many = [(0.25, 0.25)] * 3
    middle = shift_and_add(np.stack([np.full((2, 2), v) for v in (1.0, 9.0, 2.0)]), None, many, 2,
                           "median")  # fmt: skip
    np.testing.assert_allclose(middle.image, 2.0)


def test_drizzle_of_a_wide_burst_is_not_turned_round() -> None:
    frames = np.random.default_rng(12).random((1, 16, 64))
    result = drizzle_frames(frames, None, [(0.0, 0.0)], 2, pixfrac=1.0)
    np.testing.assert_allclose(result.image, np.kron(frames[0], np.ones((2, 2))), atol=1e-6)


def test_nearest_repeats_pixels_and_breaks_ties_towards_home() -> None:
    frame = np.arange(6.0).reshape(2, 3)
    repeated = np.kron(frame, np.ones((2, 2)))
    for offset_px in ((0.0, 0.0), (0.25, -0.25), (-0.25, 0.25), (0.1, 0.2)):
        np.testing.assert_array_equal(nearest(frame, None, offset_px, 2).image, repeated)
    moved = nearest(frame, None, (0.0, 1.0), 2).image  # content moved right: look to the right
    np.testing.assert_array_equal(moved[0], [1, 1, 2, 2, 2, 2])


def test_holes_are_filled_from_around_and_known_pixels_stay() -> None:
    image = np.random.default_rng(13).random((12, 20))
    weight = np.ones(image.shape)
    weight[3:9, 5:16] = 0.0
    filled, variance = fill_holes(image, weight, np.ones(image.shape))
    np.testing.assert_array_equal(filled[weight > 0], image[weight > 0])
    assert (variance[weight == 0] < 1).all()
    assert 0 < filled[weight == 0].min() <= filled[weight == 0].max() < 1
    corner = np.zeros(image.shape)
    corner[0, 0] = 0.3
    np.testing.assert_allclose(fill_holes(image, corner, corner)[0], image[0, 0])
    with pytest.raises(ValueError, match="nothing is left"):
        fill_holes(image, 0 * weight, weight)


def test_gaussian_psf_is_as_wide_as_it_says() -> None:
    for sigma_hr_px in (0.3, 0.6, 1.5):
        psf = gaussian_psf(sigma_hr_px)
        line = psf.sum(axis=0)
        at = np.arange(line.size) - line.size // 2
        assert line.sum() == pytest.approx(1.0)
        assert np.sqrt((line * at**2).sum()) == pytest.approx(sigma_hr_px, abs=0.02)


def test_deconvolution_undoes_a_blur() -> None:
    from scipy.ndimage import gaussian_filter

    sharp = gaussian_filter(np.random.default_rng(14).random((40, 50)), 1.2)
    blurred = gaussian_filter(sharp, 0.8, truncate=8)
    for method in ("wiener", "unsupervised", "richardson-lucy"):
        result = deconvolution(blurred, None, (0.0, 0.0), 1, 0.8, 1e-4, method)
        before = np.sqrt(np.mean((blurred - sharp)[5:-5, 5:-5] ** 2))
        after = np.sqrt(np.mean((result.image - sharp)[5:-5, 5:-5] ** 2))
        assert after < 0.5 * before, method


def test_more_noise_is_sharpened_less() -> None:
    frame = random_frames(15)[0]
    rough = [
        np.std(np.diff(deconvolution(frame, None, (0, 0), 2, 0.3, sigma).image))
        for sigma in (0.0, 0.05, 0.2)
    ]
    assert rough[0] > rough[1] > rough[2]


@pytest.mark.parametrize("components", [1, 2])
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05, 0.2])
@pytest.mark.parametrize(("sigma_px", "period_px"), [(0.6, 6), (1.0, 10)])
def test_a_wave_is_sharpened_as_the_wiener_filter_says(
    sigma_px: float, period_px: int, noise: float, components: int
) -> None:
    """Mirrored as it goes on, and of a whole number of periods with its margins."""
    phase = 2 * np.pi / period_px
    wave = np.tile(0.7 * np.cos(phase * (np.arange(3.0 * period_px) + 0.5))[:, None], 17)
    psf, laplacian = np.exp(-((sigma_px * phase) ** 2) / 2), 2 - 2 * np.cos(phase)
    rough = np.mean((laplacian * wave) ** 2) * (1 if components == 1 else (1 + 4) / 2)
    detail = max(rough - (4**2 + 4) * noise**2, 0.05 * rough)
    gain = psf / (psf**2 + (1e-3 + noise**2 / detail) * laplacian**2)
    for frame in (wave * (1, 1 + 2j)[components - 1], wave.T * (-1, 2 - 1j)[components - 1]):
        found = deconvolution(frame, None, (0.0, 0.0), 1, sigma_px, noise).image
        np.testing.assert_allclose(found, gain * frame, atol=1e-3)


PEERS = {
    "nearest": METHODS["nearest"],
    "bicubic_1frame": bicubic,
    "bicubic_mean": METHODS["bicubic mean"],
    "bicubic_median": METHODS["bicubic median"],
    "shift_and_add": shift_and_add,
    "drizzle_pf0.5": drizzle_frames,
    "drizzle_pf1.0": METHODS["drizzle large drops"],
    "drizzle_pt": METHODS["drizzle points"],
}


@pytest.mark.parametrize(
    "case", ["edge_x2_4f", "tofamp_x2_4f", "tofdepth_x2_4f", "cam_x2_4f", "camout_x3_12f"]
)
def test_peers_get_the_same_numbers(reference_dir: Path, case: str) -> None:
    folder = reference_dir / "irwsr"
    peers = json.loads((folder / "peers_results.json").read_text())[case]
    with np.load(folder / f"{case}_input.npz") as given:
        frames, offset_px = np.moveaxis(given["LR"], 2, 0), -given["shifts"][:, ::-1]
        scale, truth = int(given["mag"]), given["gt"]
    for name, method in PEERS.items():
        image = method(frames, None, offset_px, scale).image
        psnr_db = -10 * np.log10(np.mean((image - truth)[4:-4, 4:-4] ** 2))
        # Peers filled the empty pixels of the irregular case in another way.
        tolerance_db = 0.1 if case.startswith("camout") else 0.01
        assert psnr_db == pytest.approx(peers[name]["psnr_crop4"], abs=tolerance_db), name


def test_phasors_of_a_scene_are_interlaced_like_their_components(reference_dir: Path) -> None:
    with np.load(reference_dir / "irwsr" / "tofphasor_x2_4f_input.npz") as given:
        frames, offset_px = np.moveaxis(given["LR"], 2, 0), -given["shifts"][:, ::-1]
        truth = given["gt"]
    error = np.abs(shift_and_add(frames, None, offset_px, 2).image - truth)[4:-4, 4:-4]
    single = np.abs(bicubic(frames, None, offset_px, 2).image - truth)[4:-4, 4:-4]
    assert np.sqrt(np.mean(error**2)) < 0.7 * np.sqrt(np.mean(single**2))


@pytest.mark.parametrize(
    ("method", "settings", "message"),
    [
        ("bicubic", {"blind": 0, "frame": 0}, "frame 0 has no valid pixel"),
        ("nearest", {"blind": 0, "frame": 0}, "frame 0 has no valid pixel"),
        ("deconvolution", {"blind": 0, "frame": 0}, "frame 0 has no valid pixel"),
        ("bicubic", {"frame": 7}, "frame from 0 to 4"),
        ("bicubic", {"combine": "sum"}, "combine"),
        ("shift-and-add", {"combine": "sum"}, "combine"),
        ("drizzle", {"pixfrac": 0.0}, "pixfrac"),
        ("drizzle", {"pixfrac": 1.1}, "pixfrac"),
        ("drizzle", {"kernel": "lanczos3"}, "kernel"),
        ("deconvolution", {"psf_sigma_px": 0.0}, "psf_sigma_px"),
        ("deconvolution", {"noise_sigma": -1.0}, "noise_sigma"),
        ("deconvolution", {"algorithm": "magic"}, "algorithm"),
        ("deconvolution", {"factor": -1, "algorithm": "richardson-lucy"}, "at least"),
        ("deconvolution", {"factor": 1j, "algorithm": "richardson-lucy"}, "complex"),
    ],
)
def test_nonsense_is_refused(method: str, settings: dict[str, object], message: str) -> None:
    settings = dict(settings)
    frames, valid = random_frames(17) * settings.pop("factor", 1), np.ones((5, *SHAPE), bool)
    if "blind" in settings:
        valid[settings.pop("blind")] = False
    burst = Burst.from_arrays(frames, offset_px=OFFSET_PX, valid=valid)
    with pytest.raises(ValueError, match=message):
        reconstruct(burst, SCALE, method, channel="amplitude", **settings)


@pytest.mark.parametrize("method", [shift_and_add, drizzle_frames])
def test_frames_that_all_lie_elsewhere_are_refused(method: Method) -> None:
    with pytest.raises(ValueError, match="falls into"):
        method(random_frames(17), None, OFFSET_PX + 100, 2)
