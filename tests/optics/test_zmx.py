"""Zemax files: what is written reads back, in this program and another, and errors are placed."""

import contextlib
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lenses import pupil_grid

from lensshift.core.errors import DataError
from lensshift.optics.lens import Element, Lens, Stop, Surface, cover_glass
from lensshift.optics.lens_file import format_lens, lens_names, load_lens, parse_lens
from lensshift.optics.trace import trace
from lensshift.optics.zmx import load_zmx, parse_zmx
from lensshift.optics.zmx_writer import format_zmx, save_zmx

POINTS = pupil_grid(5)
FIELD = np.array([0.02, 0.09])

# A cemented doublet as a design program writes it: the stop on the first surface, entries that do
# not matter here, the aperture as an F-number.
DOUBLET = """VERS 140124 0 123457
MODE SEQ
NAME a doublet
UNIT MM X W X CM MR CPMM
FNUM 10.0 0
ENVD 2.0E+001 1 0
GCAT SCHOTT MISC
WAVM 1 0.4861327 1
WAVM 2 0.5875618 1
PWAV 2
SURF 0
  TYPE STANDARD
  CURV 0.0 0 0 0 0 ""
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.0163 0 0 0 0 ""
  DISZ 6.0
  GLAS N-BK7 0 0 1.5168 64.17 0 0 0 0 0 0
  DIAM 12.7 1 0 0 1 ""
SURF 2
  TYPE STANDARD
  CURV -0.0223
  DISZ 2.5
  GLAS N-SF11 0 0
  DIAM 12.7 1 0 0 1 ""
SURF 3
  TYPE EVENASPH
  CURV -0.0077
  CONI -0.5
  PARM 1 0
  PARM 2 1.0E-7
  PARM 3 0
  DISZ 95.0
SURF 4
  TYPE STANDARD
  CURV 0.0
  DISZ 0
"""


def same_rays(first: Lens, second: Lens, tolerance_mm: float) -> None:
    one, other = trace(first, FIELD, POINTS), trace(second, FIELD, POINTS)
    assert other.position_mm == pytest.approx(one.position_mm, abs=tolerance_mm)
    assert other.direction == pytest.approx(one.direction, abs=tolerance_mm)
    assert np.ptp(other.path_mm - one.path_mm) < 10 * tolerance_mm


@pytest.mark.parametrize("name", lens_names())
def test_shipped_lenses_read_back(name: str, tmp_path: Path) -> None:
    lens = load_lens(name)
    save_zmx(lens, tmp_path / "lens.zmx")
    same_rays(lens, load_zmx(tmp_path / "lens.zmx"), 1e-10)


def test_a_warm_lens_reads_back_warm() -> None:
    lens = replace(load_lens("petzval_a"), temperature_c=60.0)
    assert "ENVD 60.0 1 1" in format_zmx(lens)  # 0: programs leave the indices at 20 C
    same_rays(lens, parse_zmx(format_zmx(lens)), 1e-9)


@pytest.mark.parametrize("stop", [Stop(12.0, -4.0), Stop(8.0, 30.0), Stop(2.0, 43.0)])
@pytest.mark.parametrize("object_mm", [3500.0, math.inf])
def test_moved_and_tilted_elements_read_back(stop: Stop, object_mm: float) -> None:
    lens = replace(load_lens("petzval_a"), stop=stop, object_mm=object_mm)
    lens = lens.with_decenter(0, (0.1, -0.2)).with_tilt(1, (0.02, -0.03))
    lens = lens.with_decenter(2, (0.05, 0.0)).with_tilt(2, (-0.01, 0.04))
    back = parse_zmx(format_zmx(lens))
    same_rays(lens, back, 1e-9)
    for wanted, got in zip(lens.elements, back.elements, strict=True):
        assert got.name == (wanted.name or got.name)
        assert got.decenter_mm == pytest.approx(wanted.decenter_mm, abs=1e-12)
        assert got.tilt_rad == pytest.approx(wanted.tilt_rad, abs=1e-12)
    assert back.gaps_mm == pytest.approx(lens.gaps_mm)
    assert back.stop.diameter_mm == pytest.approx(stop.diameter_mm)


def test_a_stop_behind_all_elements_reads_back() -> None:
    lens = replace(load_lens("al2550"), stop=Stop(6.0, 20.0))
    same_rays(lens, parse_zmx(format_zmx(lens)), 1e-9)


def test_a_cemented_doublet() -> None:
    lens = parse_zmx(DOUBLET)
    assert lens.name == "a doublet"
    assert lens.wavelength_nm == pytest.approx(587.5618)
    assert math.isinf(lens.object_mm)
    assert len(lens.elements) == 1
    element = lens.elements[0]
    assert element.glass == ("N-BK7", "N-SF11")
    assert element.thickness_mm == (6.0, 2.5)
    assert element.surfaces[2] == Surface(1.0 / -0.0077, -0.5, (1e-7,))
    assert lens.gaps_mm == (95.0,)
    from lensshift.optics.paraxial import paraxial

    assert paraxial(lens).f_number == pytest.approx(10.0)
    floating = DOUBLET.replace("FNUM 10.0 0", "FLOA")
    assert parse_zmx(floating).stop.diameter_mm == pytest.approx(25.4)


def test_utf_16_files_and_glass_names(tmp_path: Path) -> None:
    silica = Element((Surface(30.0), Surface(math.inf)), ("fused silica",), (3.0,))
    lens = Lens((silica, cover_glass("N-BK7", 1.0)), (50.0, 1.0), Stop(5.0))
    text = format_zmx(lens)
    assert "GLAS F_SILICA" in text
    path = tmp_path / "lens.zmx"
    path.write_text(text, encoding="utf-16")
    same_rays(lens, load_zmx(path), 1e-12)


def test_coordinate_breaks_turn_about_x_then_y_then_z() -> None:
    # A turn about z changes nothing for surfaces of revolution, and the axis of a lens that is
    # turned about x and then about its own y leans as the product of right-handed rotations.
    away = "SURF 1\n  TYPE COORDBRK\n  PARM 3 2.0\n  PARM 4 3.0\n  PARM 5 40.0\n  DISZ 0\n"
    back = "SURF 5\n  TYPE COORDBRK\n  PARM 3 -2.0\n  PARM 4 -3.0\n  PARM 5 -40.0\n"
    back += "  PARM 6 1\n  DISZ 103.5\n"
    text = DOUBLET.replace("SURF 4", "SURF 6").replace("DISZ 95.0", "DISZ -8.5")
    text = text.replace("SURF 1\n", away + "SURF 2\n", 1).replace("SURF 6", back + "SURF 6")
    element = parse_zmx(text).elements[0]
    x_rad, y_rad = math.radians(2.0), math.radians(3.0)
    axis = (math.sin(y_rad), -math.sin(x_rad) * math.cos(y_rad))
    row_rad, col_rad = element.tilt_rad
    assert (math.sin(col_rad), math.sin(row_rad) * math.cos(col_rad)) == pytest.approx(axis)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("MODE SEQ", "MODE NSC", "line 2: expected a sequential file"),
        ("UNIT MM", "UNIT FURLONG", "line 4: expected lengths in MM, CM, IN"),
        (
            "TYPE EVENASPH",
            "TYPE TOROIDAL",
            "surface 3, line 28: line 29: .*got TOROIDAL, which is no surface of rev",
        ),
        ("GLAS N-SF11", "GLAS X-FD4", "surface 2, line 22: line 26: .*got X-FD4: load the cat"),
        ("GLAS N-SF11", "GLAS MIRROR", "surface 2: expected a positive thickness, got -2.5"),
        ("CURV -0.0223", "CURV flat", "surface 2, line 22: line 24: expected values after CURV"),
        ("DISZ 95.0", "DISZ", "surface 3, line 28: line 35: expected values after DISZ"),
        ("DISZ 2.5", "DISZ INFINITY", "surface 2, line 22: expected a finite distance"),
        ("DISZ 2.5", "DISZ -2.5", "surface 1, line 15: surface 2: expected a positive thickness"),
        ("PARM 1 0", "PARM 99999999999 0.1", "line 32: expected a parameter up to 8"),
        ("FNUM 10.0", "FNUM 0", "line 5: expected a positive FNUM, got 0"),
        ("  STOP\n", "", "one surface marked STOP, got 0"),
        ("PWAV 2", "PWAV 3", "PWAV: expected a wavelength number 3"),
        ("DISZ 95.0", "DISZ 95.0\n  GLAS N-BK7", "expected air in front of the image"),
        (
            "SURF 3\n",
            "SURF 9\n  TYPE COORDBRK\n  PARM 1 1.0\n  PARM 3 2.0\n  DISZ 0\nSURF 3\n",
            "surface 1, line 15: expected the vertices of an element on one line",
        ),
        ("DISZ 6.0", "DISZ 0.1", "overlap"),
    ],
)
def test_bad_files_are_named_with_line_and_surface(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in DOUBLET
    path = tmp_path / "bad.zmx"
    path.write_text(DOUBLET.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(DataError, match=rf"bad\.zmx: (.|\n)*{message}"):
        load_zmx(path)


WORDS = ["", "nan", "-inf", "0", "-5", "1e400", "x", "99999999999999999999", "STOP", "SURF", "GLAS"]


@pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")
@settings(max_examples=40)
@given(data=st.data())
def test_damaged_files_raise_nothing_but_data_errors(data: st.DataObject) -> None:
    lens = load_lens("petzval_a").with_decenter(0, (0.1, 0.2)).with_tilt(1, (0.01, 0.0))
    for text, parse in ((format_zmx(lens), parse_zmx), (format_lens(lens), parse_lens)):
        lines = text.splitlines()
        for _ in range(data.draw(st.integers(1, 3))):
            number = data.draw(st.integers(0, len(lines) - 1))
            words = lines[number].split(" ")
            words[data.draw(st.integers(0, len(words) - 1))] = data.draw(st.sampled_from(WORDS))
            lines[number] = " ".join(words)
        with contextlib.suppress(DataError):
            assert isinstance(parse("\n".join(lines)), Lens)


@pytest.mark.parametrize("word", ["-inf", "nan", "INFINITY"])
@pytest.mark.parametrize("key", ["PARM 1", "PARM 3", "CURV", "CONI"])
def test_numbers_that_are_none_are_refused_with_their_line(key: str, word: str) -> None:
    text = DOUBLET.replace("SURF 4", f"SURF 4\n  TYPE COORDBRK\n  {key} {word}\n  DISZ 0\nSURF 5")
    with pytest.raises(DataError, match=rf"line \d+: expected values after {key[:4]}.*{word}"):
        parse_zmx(text)


def test_files_that_are_no_lens(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot read"):
        load_zmx(tmp_path / "missing.zmx")
    (tmp_path / "empty.zmx").write_text("")
    with pytest.raises(DataError, match=r"empty\.zmx: expected surfaces .*, got none"):
        load_zmx(tmp_path / "empty.zmx")
    with pytest.raises(DataError, match="at least one surface and an image, got 1"):
        parse_zmx(DOUBLET.split("SURF 1")[0])
    (tmp_path / "binary.zmx").write_bytes(b"\xff\xfe\x00\xd8\x00")
    with pytest.raises(DataError, match="UTF-8 or UTF-16"):
        load_zmx(tmp_path / "binary.zmx")
    with pytest.raises(DataError, match="cannot write"):
        save_zmx(load_lens("al2550"), tmp_path / "missing" / "lens.zmx")
    image = DOUBLET.replace("SURF 4", "SURF 4\n  TYPE COORDBRK\n  PARM 3 1.0\n  DISZ 0\nSURF 5")
    with pytest.raises(DataError, match=r"surface 5, .*image plane centred"):
        parse_zmx(image)
    moved = load_lens("petzval_a").with_decenter(0, (0.1, 0.0))
    with pytest.raises(ValueError, match="stop fixed in space"):
        format_zmx(replace(moved, stop=replace(moved.stop, rides_on=0)))


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("case", ["centred", "moved", "tilted"])
def test_optiland_reads_the_same_lens(tmp_path: Path, case: str) -> None:
    reading = pytest.importorskip("optiland.fileio")
    lens = replace(load_lens("petzval_a"), object_mm=math.inf)
    if case == "moved":
        lens = lens.with_decenter(0, (0.1, -0.2)).with_decenter(2, (0.0, 0.2))
    elif case == "tilted":
        lens = lens.with_tilt(0, (0.01, 0.0)).with_tilt(1, (0.0, -0.02)).with_tilt(2, (0.03, 0.0))
    save_zmx(lens, tmp_path / "lens.zmx")
    optic = reading.load_zemax_file(str(tmp_path / "lens.zmx"))
    rays_type = pytest.importorskip("optiland.rays").RealRays
    points = 10.0 * POINTS
    slopes = np.array([*FIELD[::-1], 1.0]) / np.linalg.norm([*FIELD, 1.0])
    ones = np.ones(len(points))
    rays = rays_type(
        points[:, 1], points[:, 0], 0.0 * ones, *(s * ones for s in slopes), ones, 0.85 * ones
    )
    optic.surfaces.trace(rays)
    ours = trace(lens, FIELD, POINTS)
    assert ours.position_mm[:, 1] == pytest.approx(np.asarray(rays.x), abs=1e-6)
    assert ours.position_mm[:, 0] == pytest.approx(np.asarray(rays.y), abs=1e-6)
    paths = np.asarray(rays.opd) - ours.path_mm
    assert np.ptp(paths + (points @ FIELD) * slopes[2]) < 1e-3 * 850e-6
