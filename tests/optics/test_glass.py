"""Refractive indices against the makers' data sheets."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.optics.glass import GLASSES, air_index, glass_names, refractive_index
from lensshift.optics.glass_called import glass_in_light


@pytest.mark.parametrize(
    ("glass", "temperature_c", "index_d"),
    [
        ("N-BK7", 20.0, 1.51680),
        ("N-SF11", 20.0, 1.78472),
        ("L-BAL35", 25.0, 1.58913),
        ("fused silica", 20.0, 1.45846),
    ],
)
def test_indices_at_the_d_line_are_those_of_the_data_sheets(
    glass: str, temperature_c: float, index_d: float
) -> None:
    assert refractive_index(glass, 587.5618, temperature_c) == pytest.approx(index_d, abs=1e-5)


def test_change_with_temperature_is_that_of_the_data_sheet() -> None:
    # SCHOTT N-BK7: relative dn/dT at 20 to 40 degrees C is 3.0e-6 (e line) and 2.4e-6 (1060 nm).
    for wavelength_nm, slope in ((546.074, 3.0e-6), (1060.0, 2.4e-6)):
        warm = refractive_index("N-BK7", wavelength_nm, 40.0)
        cool = refractive_index("N-BK7", wavelength_nm, 20.0)
        assert (warm - cool) / 20.0 == pytest.approx(slope, abs=0.06e-6)


def test_air() -> None:
    assert refractive_index("air", 850.0, 35.0) == 1.0
    # Standard air at 15 degrees C and the d line: n - 1 = 2.7726e-4 (Edlen's formula gives the
    # same to 1e-8).
    assert air_index(587.56, 15.0) - 1.0 == pytest.approx(2.772e-4, abs=2e-7)


@given(glass=st.sampled_from(sorted(GLASSES)), wavelength_nm=st.floats(400.0, 1200.0))
def test_dispersion_is_normal_and_indices_are_continuous_in_temperature(
    glass: str, wavelength_nm: float
) -> None:
    index = refractive_index(glass, wavelength_nm)
    assert refractive_index(glass, wavelength_nm + 10.0) < index
    assert refractive_index(glass, wavelength_nm, 20.001) == pytest.approx(index, abs=1e-7)


def test_unknown_glass_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"N-BK7.*got 'N-BK8'"):
        refractive_index("N-BK8", 850.0)
    assert {"air", "N-BK7", "N-SF11", "L-BAL35", "fused silica", "CAF2"} < set(glass_names())


def test_wavelength_outside_the_measured_range() -> None:
    with pytest.raises(ValueError, match="wavelength from 300 to 2500 nm"):
        refractive_index("N-BK7", 100.0)


@pytest.mark.parametrize("wavelength_nm", [0.94, 85.0, 9e4])
def test_light_far_from_a_glass_is_told_with_its_name(wavelength_nm: float) -> None:
    # Not as a model glass that nobody asked for.
    assert glass_in_light("N-BK7", wavelength_nm) == ("N-BK7", None)
