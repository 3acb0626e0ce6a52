"""The numbers agree with closed forms and with the stored runs of the toolbox."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.evaluation import Fidelity, fidelity, psnr_db, rmse, ssim

TRUTH = np.random.default_rng(0).random((21, 33))
STORED = [
    (case, method)
    for case in ("edge_x2_4f", "tofamp_x2_4f", "tofdepth_x2_4f", "cam_x2_4f", "camout_x3_12f")
    for method in ("irwsr_cv", "irwsr_fix", "irwsr_P2", "l1btv", "l2btv", "bep")
]


@pytest.mark.parametrize(("case", "method"), STORED)
def test_numbers_of_the_toolbox_runs(reference_dir: Path, case: str, method: str) -> None:
    folder = reference_dir / "irwsr"
    results = json.loads((folder / "toolbox_results.json").read_text())
    stored = next(row for row in results if (row["case"], row["method"]) == (case, method))
    with (
        np.load(folder / f"{case}_input.npz") as inputs,
        np.load(folder / f"{case}_toolbox.npz") as outputs,
    ):
        truth, image = inputs["gt"], outputs[method]
    assert psnr_db(image, truth) == pytest.approx(stored["psnr_crop4"], abs=6e-4)
    assert ssim(image, truth) == pytest.approx(stored["ssim_crop4"], abs=6e-5)
    assert psnr_db(image, truth, border_px=0) == pytest.approx(stored["psnr_full"], abs=6e-4)


@given(error=st.floats(1e-6, 0.5), peak=st.sampled_from([1.0, 255.0]))
def test_constant_error_has_a_closed_form(error: float, peak: float) -> None:
    image = (TRUTH + error) * peak
    assert rmse(image, TRUTH * peak) == pytest.approx(error * peak, rel=1e-6)
    assert psnr_db(image, TRUTH * peak, peak=peak) == pytest.approx(-20 * np.log10(error), abs=1e-5)


def test_ssim_of_a_constant_error_on_a_flat_image() -> None:
    # Without structure only the luminance term (2ab + c) / (a^2 + b^2 + c) is left.
    a, b, c = 0.5, 0.7, 0.01**2
    flat = np.full((21, 33), a)
    expected = (2 * a * b + c) / (a**2 + b**2 + c)
    assert ssim(flat + (b - a), flat) == pytest.approx(expected, rel=1e-9)


def test_identical_images() -> None:
    assert fidelity(TRUTH, TRUTH) == Fidelity(psnr_db=float("inf"), ssim=1.0, rmse=0.0)


def test_border_is_left_out() -> None:
    image = TRUTH.copy()
    image[:4] = np.nan
    image[:, -4:] = np.inf
    assert fidelity(image, TRUTH).rmse == 0.0
    image[4, 10] += 0.1
    assert rmse(image, TRUTH) > 0
    assert rmse(image, TRUTH, border_px=5) == 0.0


def test_integers_do_not_wrap() -> None:
    image = np.full((21, 33), 3, np.uint8)
    assert rmse(image, np.full((21, 33), 5, np.uint8)) == 2.0


@pytest.mark.parametrize(
    ("image", "truth", "options", "said"),
    [
        (TRUTH[:, :-1], TRUTH, {}, r"expected an image of shape \(21, 33\), got \(21, 32\)"),
        (TRUTH.T, TRUTH, {}, r"got \(33, 21\)"),
        (TRUTH * 1j, TRUTH, {}, "expected a real image, got dtype complex128"),
        (TRUTH, TRUTH * 1j, {}, "expected a real truth"),
        (TRUTH[0], TRUTH, {}, r"expected the image as \[row col\]"),
        (TRUTH, TRUTH[None], {}, r"expected the truth as \[row col\]"),
        (TRUTH, TRUTH, {"border_px": -1}, "expected a border from 0 to 10"),
        (TRUTH, TRUTH, {"border_px": 11}, "expected a border from 0 to 10"),
        (TRUTH, TRUTH, {"peak": 0.0}, "expected a positive peak"),
        (TRUTH, TRUTH, {"peak": float("nan")}, "expected a positive peak"),
        (np.full_like(TRUTH, np.nan), TRUTH, {}, "325 NaN or infinite in the image"),
        (TRUTH, np.full_like(TRUTH, np.inf), {}, "325 NaN or infinite in the truth"),
        ([["a"]], TRUTH, {}, "expected a real image"),
    ],
)
def test_mistakes_say_expected_and_got(
    image: Any, truth: Any, options: dict[str, Any], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        fidelity(image, truth, **options)


def test_images_of_sensors_that_are_too_small_for_a_window_have_no_ssim() -> None:
    truth = np.arange(18.0 * 24).reshape(18, 24)  # 10 x 16 inside the border
    found = fidelity(truth + 2.0, truth, peak=2.0)
    assert (found.rmse, found.psnr_db) == (2.0, 0.0)
    assert np.isnan(found.ssim)
    with pytest.raises(ValueError, match="at least 11 x 11 pixels"):
        ssim(truth, truth)
