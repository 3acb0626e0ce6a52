"""The way to Optiland and back; without Optiland, that the message says what is missing."""

import math
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
from lenses import pupil_grid, same_rays

from lensshift.core.errors import DataError
from lensshift.optics.lens import Lens, Stop, cover_glass
from lensshift.optics.lens_file import lens_names, load_lens
from lensshift.optics.optiland import from_optiland, to_optiland
from lensshift.optics.paraxial import paraxial
from lensshift.optics.trace import trace

FIELD = np.array([0.03, 0.09])
POINTS = pupil_grid(5)


def test_without_optiland_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "optiland"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "optiland", None)
    with pytest.raises(ImportError, match=r"pip install lensshift\[optiland\]"):
        to_optiland(load_lens("petzval_a"))
    with pytest.raises(ImportError, match=r"pip install lensshift\[optiland\]"):
        from_optiland(object())


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("name", lens_names())
def test_shipped_lenses_trace_alike_and_come_back(name: str) -> None:
    pytest.importorskip("optiland")
    lens = replace(load_lens(name), temperature_c=35.0)
    optic = to_optiland(lens)
    data = paraxial(lens)
    assert float(np.ravel(optic.paraxial.f2())[0]) == pytest.approx(data.focal_length_mm, abs=1e-6)
    assert float(np.ravel(optic.paraxial.EPD())[0]) == pytest.approx(
        data.entrance_pupil_diameter_mm, abs=1e-6
    )
    same_rays(lens, optic, FIELD, POINTS)
    back = from_optiland(optic)
    assert back.name == lens.name
    assert back.stop.diameter_mm == pytest.approx(lens.stop.diameter_mm)
    assert back.object_mm == pytest.approx(lens.object_mm)
    same_rays(replace(back, temperature_c=35.0), optic, FIELD, POINTS)


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    "stop", [Stop(20.0), Stop(12.0, -4.0), Stop(8.0, 20.0), Stop(20.0, 0.0, 0)]
)
@pytest.mark.parametrize("object_mm", [3500.0, math.inf])
def test_moved_and_tilted_elements(stop: Stop, object_mm: float) -> None:
    pytest.importorskip("optiland")
    lens = replace(load_lens("petzval_a"), stop=stop, object_mm=object_mm)
    lens = lens.with_decenter(0, (0.1, -0.2)).with_tilt(1, (0.02, -0.03))
    lens = lens.with_decenter(2, (0.05, 0.0)).with_tilt(2, (-0.01, 0.04))
    optic = to_optiland(lens)
    same_rays(lens, optic, FIELD, POINTS)
    back = from_optiland(optic)
    for wanted, got in zip(lens.elements, back.elements, strict=True):
        assert got.decenter_mm == pytest.approx(wanted.decenter_mm, abs=1e-9)
        assert got.tilt_rad == pytest.approx(wanted.tilt_rad, abs=1e-9)
        assert got.surfaces == wanted.surfaces
    assert back.gaps_mm == pytest.approx(lens.gaps_mm)


@pytest.mark.filterwarnings("default")
def test_a_lens_from_its_own_catalogue() -> None:
    optic = pytest.importorskip("optiland.optic").Optic()
    optic.surfaces.add(index=0, thickness=math.inf)
    optic.surfaces.add(index=1, radius=60.0, thickness=5.0, material="N-BK7", is_stop=True)
    optic.surfaces.add(index=2, radius=-45.0, thickness=2.0, material="N-SF11")
    optic.surfaces.add(index=3, radius=-200.0, thickness=95.0, conic=-0.5)
    optic.surfaces.add(index=4)
    optic.set_aperture("EPD", 10.0)
    optic.fields.set_type("angle")
    optic.fields.add(y=0.0)
    optic.wavelengths.add(0.5876, is_primary=True)
    lens = from_optiland(optic)
    assert lens.elements[0].glass == ("N-BK7", "N-SF11")
    assert lens.elements[0].surfaces[2].conic == -0.5
    assert paraxial(lens).entrance_pupil_diameter_mm == pytest.approx(10.0)
    assert paraxial(lens).focal_length_mm == pytest.approx(
        float(np.ravel(optic.paraxial.f2())[0]), abs=1e-4
    )
    optic.set_aperture("imageFNO", 8.0)
    assert paraxial(from_optiland(optic)).f_number == pytest.approx(8.0)


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"index": 1.61}, "surface 1: expected a glass of N-BK7.*got one of index 1.61"),
        ({"surface_type": "odd_asphere", "coefficients": [1e-5]}, "surface 1: .*got OddAsphere"),
        ({"material": "mirror"}, "surface 1: expected lenses, got a mirror"),
    ],
)
def test_what_cannot_come_back_is_named(change: dict, message: str) -> None:
    optic = pytest.importorskip("optiland.optic").Optic()
    optic.surfaces.add(index=0, thickness=math.inf)
    first = {"radius": 60.0, "thickness": 5.0, "material": "N-BK7", "is_stop": True} | change
    if "index" in first:
        first["material"] = pytest.importorskip("optiland.materials").IdealMaterial(
            first.pop("index")
        )
    optic.surfaces.add(index=1, **first)
    optic.surfaces.add(index=2, radius=-45.0, thickness=50.0)
    optic.surfaces.add(index=3)
    optic.set_aperture("EPD", 10.0)
    optic.wavelengths.add(0.5876, is_primary=True)
    with pytest.raises(DataError, match=message):
        from_optiland(optic)


@pytest.mark.filterwarnings("default")
def test_a_cover_glass_of_infinite_size() -> None:
    pytest.importorskip("optiland")
    lens = load_lens("al2550")
    lens = Lens((*lens.elements, cover_glass("fused silica", 1.0)), (40.0, 5.3), Stop(10.0))
    optic = to_optiland(lens)
    same_rays(lens, optic, FIELD, POINTS)
    back = from_optiland(optic)
    assert [one.glass for one in back.elements] == [("N-BK7",), ("fused silica",)]
    assert math.isinf(back.elements[1].surfaces[0].semi_diameter_mm)


@pytest.mark.filterwarnings("default")
def test_an_obstruction_goes_and_comes_back() -> None:
    pytest.importorskip("optiland")
    lens = load_lens("al2550")
    front = replace(lens.elements[0].surfaces[0], inner_mm=3.0)
    element = replace(lens.elements[0], surfaces=(front, *lens.elements[0].surfaces[1:]))
    lens = replace(lens, elements=(element,))
    optic = to_optiland(lens)
    rays = optic.trace_generic(0.0, 0.0, POINTS[:, 1], POINTS[:, 0], 1e-3 * lens.wavelength_nm)
    dark = np.asarray(rays.i) == 0
    assert dark.tolist() == (~trace(lens, [0.0, 0.0], POINTS).passed).tolist()
    assert 0 < dark.sum() < len(dark)
    assert from_optiland(optic).elements[0].surfaces[0].inner_mm == 3.0


def test_a_far_object_is_no_cause_for_warnings() -> None:
    pytest.importorskip("optiland")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert math.isinf(from_optiland(to_optiland(load_lens("al2550"))).object_mm)
