"""Images of points on lattices: against closed forms, exact OTFs and plain sums over rays."""

from typing import Any

import numpy as np
import pytest
from lenses import pupil_grid

from lensshift.optics.lattice import LatticeImage, lattice_images
from lensshift.optics.lens import Element, Lens, Stop, Surface
from lensshift.optics.lens_file import load_lens
from lensshift.optics.mtf import diffraction_mtf
from lensshift.optics.otf import PupilFit, exact_otf
from lensshift.optics.otf_kernel import annular
from lensshift.optics.spots import fields_for_image
from lensshift.optics.trace import trace

AZIMUTHS = np.linspace(0.0, np.pi, 8, endpoint=False)
AXES = np.stack([np.sin(AZIMUTHS), np.cos(AZIMUTHS)], axis=-1)


def mirror(inner: float, away_mm: float = 0.0) -> Lens:
    """Return a paraboloid at f/5, which images a point on its axis without an aberration."""
    surface = Surface(-200.0, -1.0, semi_diameter_mm=12.5, inner_mm=10 * inner, mirror=True)
    return Lens((Element((surface,), (), ()),), (100.0 + away_mm,), Stop(20.0), wavelength_nm=550.0)


def otf_of(image: LatticeImage, cycles_per_step: np.ndarray) -> np.ndarray:
    """Return sum w exp(-2 pi i f x) at frequencies [... 2] (row, col)."""
    return np.exp(-2j * np.pi * cycles_per_step @ image.place.T) @ image.weight


def lattice_image(
    lens: Lens, field_tan: np.ndarray, *sizes: np.ndarray, **options: bool
) -> LatticeImage:
    """Return the image of one field."""
    return lattice_images(lens, field_tan[None], *sizes, **options)[0]


@pytest.mark.parametrize("inner", [0.0, 0.4])
@pytest.mark.parametrize("side_mm", [0.002, 0.01])
def test_a_perfect_mirror_has_the_otf_of_its_ring(inner: float, side_mm: float) -> None:
    image = lattice_image(mirror(inner), np.zeros(2), *steps(side_mm))
    cutoff_lpmm = 2.0 * np.sin(2.0 * np.arctan(10.0 / 200.0)) / 550e-6
    lpmm = np.array([0.1, 0.3, 0.5, 0.8, 1.0]) / side_mm
    seen = otf_of(image, lpmm[None, :, None] * AXES[:, None] * side_mm / 8)
    if inner:
        expected = [annular(min(f / cutoff_lpmm, 1.0), inner) for f in lpmm]
    else:
        expected = diffraction_mtf(lpmm, cutoff_lpmm)
    np.testing.assert_allclose(seen, np.broadcast_to(expected, seen.shape), atol=0.02)
    assert image.weight.min() > 0.0
    assert image.weight.sum() == pytest.approx(1.0)


def steps(side_mm: float) -> tuple[np.ndarray, np.ndarray]:
    return np.full(2, side_mm / 8), np.full(2, 1.0 / side_mm)


@pytest.mark.parametrize("side_mm", [0.1, 0.04, 0.015])
@pytest.mark.parametrize("place_mm", [(0.0, 1.0), (1.5, 2.5)])
def test_an_aberrated_image_has_the_exact_otf(
    side_mm: float, place_mm: tuple[float, float]
) -> None:
    """From spots within a pixel to spots of many pixels."""
    lens = load_lens("al2550")
    field = fields_for_image(lens, np.array(place_mm))
    image = lattice_image(lens, field, *steps(side_mm))
    lpmm = np.array([0.1, 0.2, 0.35, 0.5, 0.75, 1.0]) / side_mm
    exact = exact_otf(lens, field, lpmm, AZIMUTHS)
    seen = otf_of(image, lpmm[None, :, None] * AXES[:, None] * side_mm / 8)
    np.testing.assert_allclose(seen, exact, atol=0.02)


def test_unlike_steps_along_rows_and_columns() -> None:
    lens, side_mm = mirror(0.0, 0.03), np.array([0.004, 0.007])
    image = lattice_image(lens, np.zeros(2), side_mm / 8, 1.0 / side_mm)
    for axis, azimuth in ((0, 0.5 * np.pi), (1, 0.0)):
        lpmm = np.array([0.2, 0.5, 1.0]) / side_mm[axis]
        exact = exact_otf(lens, [0.0, 0.0], lpmm, azimuth)[0]
        seen = otf_of(image, lpmm[:, None] * np.eye(2)[axis] * side_mm / 8)
        np.testing.assert_allclose(seen, exact, atol=0.015)


def test_rays_alone() -> None:
    """Against a fine square grid of rays, where they are not those of the lattice."""
    lens, side_mm = load_lens("petzval_b"), 0.05
    field = fields_for_image(lens, np.array([1.0, 3.0]))
    image = lattice_image(lens, field, *steps(side_mm), diffraction=False)
    rays = trace(lens, field, pupil_grid(300))
    landing_mm = rays.position_mm[rays.passed]
    landing_mm = landing_mm - landing_mm.mean(axis=0)
    lpmm = np.array([0.2, 0.5, 1.0])[None, :, None] * AXES[:, None] / side_mm
    expected = np.exp(-2j * np.pi * lpmm @ landing_mm.T).mean(axis=-1)
    assert np.abs(expected).min() < 0.8
    np.testing.assert_allclose(otf_of(image, lpmm * side_mm / 8), expected, atol=0.02)


@pytest.mark.parametrize("side_mm", [0.2, 0.02])
def test_a_spot_of_thousands_of_points_is_drawn_by_rays(side_mm: float) -> None:
    """20 mm out of focus at f/5: a disc of 4 mm, too wide for waves."""
    image = lattice_image(mirror(0.0, 20.0), np.zeros(2), *steps(side_mm))
    away_mm = np.linalg.norm(image.place, axis=-1) * side_mm / 8
    assert image.weight[away_mm < 2.1].sum() > 0.98
    assert image.weight[away_mm < 1.0].sum() == pytest.approx(0.25, abs=0.02)
    assert image.weight @ away_mm**2 == pytest.approx(0.5 * 2.0**2, rel=0.05)


@pytest.mark.parametrize("away_mm", [0.5, 1.5])
def test_a_wide_spot_before_large_pixels_takes_no_fine_wave(
    away_mm: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Far below the cutoff rays tell the OTF; waves need 400 to 1200 samples across the pupil."""
    samples = []
    waves_at = PupilFit.waves_at

    def counted(pupil: PupilFit, row: np.ndarray, *given: Any) -> Any:
        samples.append(len(row))
        return waves_at(pupil, row, *given)

    monkeypatch.setattr(PupilFit, "waves_at", counted)
    lens, side_mm = load_lens("al2550"), 0.3
    lens = lens.with_sensor(lens.gaps_mm[-1] + away_mm)
    field = fields_for_image(lens, np.array([1.0, 3.0]))
    image = lattice_image(lens, field, *steps(side_mm))
    lpmm = np.array([0.1, 0.35, 0.5, 0.75, 1.0]) / side_mm
    exact = exact_otf(lens, field, lpmm, AZIMUTHS)
    seen = otf_of(image, lpmm[None, :, None] * AXES[:, None] * side_mm / 8)
    np.testing.assert_allclose(seen, exact, atol=0.01)
    assert max(samples, default=0) < 300
