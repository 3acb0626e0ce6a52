"""An edge and a star behind one blur agree; a sharpened edge flatters."""

import numpy as np
import pytest
from scipy.special import ndtr
from seen_patterns import seen

from lensshift.core.optical import MtfCurve
from lensshift.evaluation import edge_and_pattern, siemens_star_mtf
from lensshift.evaluation.slanted_edge import measure_edge

SIGMA_PX, SHAPE = 0.9, (121, 141)


def star(noise: float, sigma_px: float = SIGMA_PX, cycles: int = 24) -> np.ndarray:
    """Return a square star, averaged over pixels and blurred."""
    pixels = seen(
        lambda row, col: 0.5 + 0.4 * np.sign(np.cos(cycles * np.arctan2(row, col))),
        SHAPE, (60.8, 70.3), sigma_px, finer=5,
    )  # fmt: skip
    rng = np.random.default_rng(2)
    return pixels + noise * rng.standard_normal(SHAPE)


def edge(sigma_px: float, noise: float) -> np.ndarray:
    row, col = np.indices((48, 61))
    normal = (col - 30.2) * np.cos(0.1) + (row - 24) * np.sin(0.1)
    rng = np.random.default_rng(3)
    pixel = 12**-0.5
    return (
        0.1
        + 0.8 * ndtr(normal / np.hypot(sigma_px, pixel))
        + noise * rng.standard_normal(row.shape)
    )


@pytest.mark.parametrize("noise", [0.002, 0.01])
def test_one_blur_agrees_and_a_sharper_edge_flatters(noise: float) -> None:
    seen = siemens_star_mtf(
        star(noise), cycles=24, pitch_mm=1.0, profile="square", levels=(0.1, 0.9)
    ).mtf
    right = measure_edge(edge(SIGMA_PX, noise)).mtf
    found = edge_and_pattern(right, seen)
    assert found.verdict == "agree"
    assert abs(found.difference) < 0.02
    sharper = edge_and_pattern(measure_edge(edge(0.6, noise)).mtf, seen)
    assert sharper.verdict == "edge flatters"
    f = sharper.frequency_lpmm
    expected = np.mean(
        np.exp(-2 * (np.pi * f) ** 2 * 0.36) - np.exp(-2 * (np.pi * f) ** 2 * SIGMA_PX**2)
    )
    assert sharper.difference == pytest.approx(expected, abs=0.05)
    softer = edge_and_pattern(measure_edge(edge(1.3, noise)).mtf, seen)
    assert softer.verdict == "pattern flatters"


def test_a_star_without_coarse_lines_does_not_judge_sharpening() -> None:
    """Its lines begin beyond where sharpening lifts the curve: the contrast came out 20 % high."""
    gain, sigmas = 0.6, (0.7, 2.0)
    sharp, soft = (star(0.0, one, 40) for one in sigmas)
    rng = np.random.default_rng(5)
    image = (1.0 + gain) * sharp - gain * soft + 0.003 * rng.standard_normal(SHAPE)
    found = siemens_star_mtf(image, cycles=40, pitch_mm=1.0, profile="square")
    unsure = found.contrast_std / found.contrast
    assert found.contrast > 1.1 * 0.8 * 4.0 / np.pi  # which no line tells
    for blur_px, verdict in ((0.7, "agree"), (0.5, "edge flatters"), (0.95, "pattern flatters")):
        light = (1.0 + gain) * edge(blur_px, 0.0) - gain * edge(sigmas[1], 0.0)
        light += 0.003 * rng.standard_normal(light.shape)
        judged = edge_and_pattern(measure_edge(light).mtf, found.mtf, unsure=unsure)
        assert judged.verdict == verdict


def test_errors_excuse_a_difference() -> None:
    f = np.linspace(0.01, 1.0, 50)
    edge_curve = MtfCurve(f, np.exp(-(f**2) * 4), np.full(50, 0.05))
    pattern = MtfCurve(f, np.exp(-(f**2) * 5), None)
    assert edge_and_pattern(edge_curve, pattern).verdict == "agree"
    sure = MtfCurve(f, edge_curve.modulation, np.full(50, 0.001))
    assert edge_and_pattern(sure, pattern).verdict == "edge flatters"


def test_too_coarse_a_pattern_is_refused() -> None:
    f = np.linspace(0.01, 1.0, 50)
    curve = MtfCurve(f, np.exp(-(f**2) * 4), None)
    coarse = MtfCurve(f[:5] / 10, np.ones(5), None)
    with pytest.raises(ValueError, match="a pattern with lines where"):
        edge_and_pattern(curve, coarse)
    few = MtfCurve(f[:1] * 20.0, np.ones(1), None)
    with pytest.raises(ValueError, match="besides the coarsest"):
        edge_and_pattern(curve, few, unsure=0.01)
