"""Eight lenses as other programs write them against batoid and Optiland."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign import FOREIGN, zmx
from lenses import batoid_trace, pupil_grid, same_rays

from lensshift.optics.otf import exact_otf
from lensshift.optics.paraxial import paraxial
from lensshift.optics.trace import Build, trace
from lensshift.optics.zmx import parse_zmx

AXIS, FIELD = np.zeros(2), np.array([0.01, -0.02])


@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_lenses_trace_as_in_batoid(name: str) -> None:
    pytest.importorskip("batoid")
    lens = parse_zmx(zmx(*FOREIGN[name]))
    points = pupil_grid(9)
    for field in (AXIS, FIELD):
        origin = np.zeros((len(points), 3))
        origin[:, :2] = 0.5 * lens.stop.diameter_mm * points
        direction = np.tile([*field, 1.0], (len(points), 1))
        if math.isfinite(lens.object_mm):
            direction = origin - [*(-field * lens.object_mm), -lens.object_mm]
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        origin -= 10.0 * direction
        position, _, path = batoid_trace(lens, Build(), origin, direction)
        found = np.isfinite(path)
        assert np.mean(found) > 0.9
        ours = trace(lens, field, points).position_mm
        assert ours[found] == pytest.approx(position[found], abs=1e-10)


def in_optiland(text: str, folder: Path) -> Any:
    """Return the lens as Optiland reads it."""
    reader = pytest.importorskip("optiland.fileio")
    path = folder / "lens.zmx"
    path.write_text(text)
    return reader.load_zemax_file(str(path))


def complete(surfaces: tuple[str, ...], fields_deg: str = "0", aperture: str = "ENPD 10") -> str:
    """Return a file with all that Optiland's reader wants: curvatures and fields."""
    whole = [one if "CURV" in one else one.replace("DISZ", "CURV 0; DISZ", 1) for one in surfaces]
    count = len(fields_deg.split())
    header = f"FTYP 0 0 {count} 1 0 0 0\nXFLN {'0 ' * count}\nYFLN {fields_deg}"
    return zmx(*whole, header=header, aperture=aperture)


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_lenses_trace_as_in_optiland(name: str, tmp_path: Path) -> None:
    text = complete(FOREIGN[name])
    optic, lens = in_optiland(text, tmp_path), parse_zmx(text)
    if name == "tilted":  # first-order data leave tilts out there, here they straighten the element
        straight = tuple(
            replace(one, tilt_rad=(0.0, 0.0), decenter_mm=(0.0, 0.0)) for one in lens.elements
        )
        data = paraxial(replace(lens, elements=straight))
    else:
        data = paraxial(lens)
        focal_mm = float(np.ravel(optic.paraxial.f2())[0])
        assert focal_mm == pytest.approx(data.focal_length_mm, abs=1e-9)
    pupil_mm = float(np.ravel(optic.paraxial.EPD())[0])
    assert pupil_mm == pytest.approx(data.entrance_pupil_diameter_mm, abs=1e-9)
    for field in (AXIS, FIELD):
        same_rays(lens, optic, field, pupil_grid(9), mm=1e-10)


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("name", FOREIGN)
def test_the_mtf_of_foreign_lenses_is_that_of_optiland(name: str, tmp_path: Path) -> None:
    """The sensor 0.15 mm in front of the paraxial image, f/8, on the axis and 2 degrees off."""
    surfaces, field_deg = list(FOREIGN[name]), 2.0
    lens = parse_zmx(zmx(*surfaces))
    apart = re.search(r"DISZ ([^;]+)", surfaces[-2])
    assert apart is not None
    last_mm = float(apart[1]) + paraxial(lens).image_mm - lens.gaps_mm[-1] - 0.15
    surfaces[-2] = surfaces[-2].replace(apart[0], f"DISZ {last_mm!r}")
    text = complete(tuple(surfaces), f"0 {field_deg}", "ENPD 8")
    optic, lens = in_optiland(text, tmp_path), parse_zmx(text)
    theirs = pytest.importorskip("optiland.mtf").FFTMTF(optic, num_rays=256, grid_size=1024)
    lpmm = np.array([5.0, 10.0, 20.0, 40.0, 80.0])
    for number, field in enumerate((AXIS, np.array([math.tan(math.radians(field_deg)), 0.0]))):
        ours = np.abs(exact_otf(lens, field, lpmm, [0.5 * np.pi, 0.0]))
        for direction, axis in enumerate((theirs.freq_tang, theirs.freq_sag)):
            wanted = np.interp(lpmm, axis[number], theirs.mtf[number][direction])
            assert 0.05 < wanted.min() < 0.6
            assert ours[direction] == pytest.approx(wanted, abs=0.005)
