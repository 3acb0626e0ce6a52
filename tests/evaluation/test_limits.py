"""The limits agree with numerical Fourier transforms and with numbers from the books."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.core.optical import MtfCurve
from lensshift.evaluation.limits import (
    diffraction_cutoff_lpmm,
    diffraction_mtf,
    first_crossing_lpmm,
    lpmm_to_cycles_per_mrad,
    paper_sensor_limit,
    pixel_aperture_mtf,
)

PITCH_MM = 0.155


@given(
    angle_rad=st.floats(-1.6, 1.6),
    fill_factor=st.floats(0.2, 1.0),
    row_mm=st.floats(0.05, 0.3),
    frequency_lpmm=st.floats(0.0, 10.0),
)
def test_pixel_is_the_fourier_transform_of_its_area(
    angle_rad: float, fill_factor: float, row_mm: float, frequency_lpmm: float
) -> None:
    col_mm, side = 0.1, np.sqrt(fill_factor)
    across = (np.arange(1000) + 0.5) / 1000 - 0.5
    row_wave = np.exp(2j * np.pi * frequency_lpmm * np.sin(angle_rad) * across * row_mm * side)
    col_wave = np.exp(2j * np.pi * frequency_lpmm * np.cos(angle_rad) * across * col_mm * side)
    expected = abs(row_wave.mean() * col_wave.mean())
    found = pixel_aperture_mtf(
        frequency_lpmm, (row_mm, col_mm), angle_rad=angle_rad, fill_factor=fill_factor
    )
    assert found == pytest.approx(expected, abs=1e-4)


def test_full_and_half_pixel_at_the_numbers_of_the_paper() -> None:
    at_lpmm = np.array([0.5, 1.0, 2.0]) / PITCH_MM
    full, half = (pixel_aperture_mtf(at_lpmm, pitch) for pitch in (PITCH_MM, PITCH_MM / 2))
    np.testing.assert_allclose(full, [2 / np.pi, 0, 0], atol=1e-12)
    np.testing.assert_allclose(half, [0.900, 0.637, 0], atol=5e-4)
    np.testing.assert_allclose(paper_sensor_limit(at_lpmm, PITCH_MM), [0.405, 0, 0], atol=5e-4)
    half_limit = paper_sensor_limit(at_lpmm, PITCH_MM / 2)
    np.testing.assert_allclose(half_limit, [0.811, 0.405, 0], atol=5e-4)


def test_diffraction_is_the_overlap_of_two_pupils() -> None:
    axis = np.linspace(-1, 1, 1201)
    row, col = np.meshgrid(axis, axis, indexing="ij")
    pupil = row**2 + col**2 <= 1
    cutoff_lpmm = diffraction_cutoff_lpmm(850.0, 2.0)
    assert cutoff_lpmm == pytest.approx(588.235, abs=1e-3)
    for v in (0.1, 0.45, 0.8):
        moved = row**2 + (col - 2 * v) ** 2 <= 1
        overlap = np.count_nonzero(pupil & moved) / np.count_nonzero(pupil)
        assert diffraction_mtf(v * cutoff_lpmm, 850.0, 2.0) == pytest.approx(overlap, abs=1e-3)
    np.testing.assert_allclose(diffraction_mtf([0, cutoff_lpmm, 2e3], 850.0, 2.0), [1, 0, 0])


def test_mtf50_of_a_pixel() -> None:
    f_lpmm = np.linspace(0, 10, 2001)
    curve = MtfCurve(f_lpmm, pixel_aperture_mtf(f_lpmm, PITCH_MM))
    assert first_crossing_lpmm(curve, 0.5) * PITCH_MM == pytest.approx(0.6034, abs=1e-4)


def test_first_crossing_is_the_first_and_linear() -> None:
    curve = MtfCurve(np.array([0.0, 1, 2, 3, 4]), np.array([1.0, 0.8, 0.3, 0.9, 0.1]))
    assert first_crossing_lpmm(curve, 0.5) == pytest.approx(1.6)
    assert first_crossing_lpmm(curve, 0.2) == pytest.approx(3.875)
    assert np.isnan(first_crossing_lpmm(curve, 0.05))
    assert np.isnan(first_crossing_lpmm(curve, 1.1))


def test_frequency_in_the_scene() -> None:
    # One pixel of 0.155 mm behind 42.7 mm sees 3.63 mrad.
    assert lpmm_to_cycles_per_mrad(1 / PITCH_MM, 42.7) == pytest.approx(1 / 3.63, rel=1e-3)


def test_bad_input() -> None:
    with pytest.raises(ValueError, match="expected a positive pitch in mm, got -1"):
        pixel_aperture_mtf(1.0, (0.1, -1.0))
    with pytest.raises(ValueError, match=r"expected a pitch in mm or a pair \(row, col\)"):
        pixel_aperture_mtf(1.0, (0.1, 0.1, 0.1))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"expected a fill factor above 0 and up to 1, got 1\.5"):
        pixel_aperture_mtf(1.0, 0.1, fill_factor=1.5)
    with pytest.raises(ValueError, match="expected a positive f-number, got 0"):
        diffraction_mtf(1.0, 850.0, 0.0)
    with pytest.raises(ValueError, match="expected a positive focal length in mm, got 0"):
        lpmm_to_cycles_per_mrad(1.0, 0.0)
