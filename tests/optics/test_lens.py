"""The lens as data, and its files."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensshift.core.errors import DataError, QualityWarning
from lensshift.optics.lens import Element, Lens, Stop, Surface, cover_glass
from lensshift.optics.lens_file import format_lens, lens_names, load_lens, parse_lens, save_lens

BALL = Surface(20.0, semi_diameter_mm=10.0)
FLAT = Surface(math.inf, semi_diameter_mm=10.0)
SINGLET = Element((BALL, FLAT), ("N-BK7",), (5.0,), name="singlet")


def test_stock_lenses_and_both_petzval_lenses_are_shipped() -> None:
    assert {"petzval_a", "petzval_b", "al2550", "eo33944", "eo33950", "eo33093"} <= set(
        lens_names()
    )
    for name in lens_names():
        lens = load_lens(name)
        assert parse_lens(format_lens(lens)) == lens


def test_save_and_load_return_the_same_lens(tmp_path: Path) -> None:
    lens = load_lens("petzval_b").with_decenter(1, (0.01, -0.02)).with_tilt(2, (0.003, 0.0))
    lens = replace(lens, stop=replace(lens.stop, rides_on=0), name='a "quoted" name \\ µ')
    save_lens(lens, tmp_path / "lens.toml")
    loaded = load_lens(tmp_path / "lens.toml")
    assert loaded.elements[2].tilt_rad == pytest.approx((0.003, 0.0), abs=1e-17)
    assert replace(loaded, elements=lens.elements) == lens
    assert loaded.elements[:2] == lens.elements[:2]


@given(
    radius_mm=st.floats(15.0, 500.0),
    conic=st.floats(-3.0, 0.5),
    a4=st.floats(-1e-6, 1e-6),
    height_mm=st.floats(0.0, 10.0),
)
def test_sag_solves_the_equation_of_the_conic(
    radius_mm: float, conic: float, a4: float, height_mm: float
) -> None:
    surface = Surface(radius_mm, conic, (a4,), 10.0)
    r = np.array([height_mm])
    z = surface.sag_mm(r) - a4 * r**4
    assert r**2 - 2 * radius_mm * z + (1 + conic) * z**2 == pytest.approx(0.0, abs=1e-9)
    assert surface.reversed().sag_mm(r) == pytest.approx(-surface.sag_mm(r))


def test_with_decenter_moves_one_element_only() -> None:
    lens = load_lens("petzval_a")
    moved = lens.with_decenter(0, (0.1, 0.2))
    assert moved.elements[0].decenter_mm == (0.1, 0.2)
    assert moved.elements[1:] == lens.elements[1:]
    assert lens.elements[0].decenter_mm == (0.0, 0.0)
    with pytest.raises(ValueError, match="element from 0 to 2, got 3"):
        lens.with_decenter(3, (0.0, 0.0))


def test_reversing_twice_changes_nothing() -> None:
    element = load_lens("al2550").elements[0]
    assert element.reversed().surfaces[1].radius_mm == -25.56
    assert element.reversed().reversed() == element


def test_positions_follow_thicknesses_and_gaps() -> None:
    lens = Lens((SINGLET, cover_glass("N-BK7", 1.0)), (30.0, 2.0), Stop(10.0))
    assert lens.positions_mm() == pytest.approx([0.0, 35.0, 38.0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Surface(0.0), "radius other than 0"),
        (lambda: Surface(5.0, semi_diameter_mm=6.0), "semi-diameter up to 5.0000 mm"),
        (lambda: Surface(5.0, semi_diameter_mm=0.0), "positive semi-diameter"),
        (lambda: Surface(5.0, math.nan), "finite conic"),
        (
            lambda: Element((BALL, FLAT), ("N-BK8",), (5.0,)),
            "surface 1: expected a known glass, .*N-BK7",
        ),
        (lambda: Element((BALL, FLAT), ("N-BK7",), (-5.0,)), "positive thickness"),
        (lambda: Element((BALL, FLAT), ("N-BK7",), (1.0,)), "surface 1: .* overlap by 1.67"),
        (lambda: Element((BALL,), (), ()), "n surfaces, n - 1 glasses"),
        (lambda: Lens((SINGLET,), (30.0,), Stop(20.5)), "stop no larger than .* 20 mm, got 20.5"),
        (lambda: Lens((SINGLET,), (30.0,), Stop(5.0, 40.0)), "in front of the sensor"),
        (lambda: Lens((SINGLET,), (30.0,), Stop(5.0, 0.0, 1)), "an element from 0 to 0"),
        (lambda: Lens((SINGLET, SINGLET), (-1.0, 1.0), Stop(5.0)), "gap of at least 0 mm"),
        (lambda: Lens((SINGLET,), (30.0,), Stop(5.0), object_mm=-1.0), "positive object distance"),
        (lambda: Lens((SINGLET,), (30.0,), Stop(5.0), wavelength_nm=9e4), "expected a wavelength"),
        (lambda: Lens((SINGLET,), (30.0,), Stop(5.0), temperature_c=-300.0), "above -273.15 C"),
        (lambda: Lens((SINGLET,), (30.0,), Stop(5.0), temperature_c=math.nan), "above -273.15 C"),
        (
            lambda: Lens((SINGLET,), (30.0,), Stop(5.0, -20.0), object_mm=10.0),
            "stop between object and sensor",
        ),
        (lambda: Stop(0.0), "positive stop diameter"),
        (
            lambda: Lens((SINGLET, SINGLET.reversed(), SINGLET), (1.0, -0.0, 9.0), Stop(5.0)),
            None,
        ),
        (
            lambda: Lens((SINGLET.reversed(), SINGLET.reversed()), (1.0, 9.0), Stop(5.0)),
            None,
        ),
        (
            lambda: Lens((SINGLET, load_lens("eo45030").elements[0]), (1.0, 9.0), Stop(5.0)),
            "surface 2: expected surface 3 behind it, but they overlap",
        ),
    ],
)
def test_lenses_that_cannot_be(make: object, message: str | None) -> None:
    assert callable(make)
    if message is None:  # close, but possible
        make()
        return
    with pytest.raises(ValueError, match=message):
        make()


PETZVAL = format_lens(load_lens("petzval_a"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "Petzval A"', "name = ", "lens.toml: is not TOML: .*line 1"),
        ('name = "Petzval A"', "name = 3", "lens.toml: name: expected str, got 3"),
        ('glass = ["N-SF11"]', 'glass = ["SF99"]', "element 3, line 4[0-9].*known glass.*'SF99'"),
        ('glass = ["N-SF11"]', "glass = [[]]", "element 3, line 4[0-9]: expected names of glasses"),
        ("position_mm = 0.0", "rides_on = true", "rides_on: expected the number of an element"),
        ("radius_mm = 25.56", "radius_mm = 0", "element 1 surface 1, line 16: expected a radius"),
        ("radius_mm = 25.56", "radius = 5", "element 1 surface 1, line 16: .*got 'radius'"),
        ("gap_mm = 29.071", "", "element 1, line 10: expected 'gap_mm', which is missing"),
        ("gap_mm = 29.071", 'gap_mm = "x"', "expected a number for 'gap_mm', got 'x'"),
        ("gap_mm = 5.5676", "gap_mm = 0.5", "surface 4: expected surface 5 behind it"),
        ("diameter_mm = 20.0", "diameter_mm = 30.0", "lens.toml: .*stop no larger"),
        ("position_mm = 0.0", "rides_on = 1.5", "rides_on: expected the number of an element"),
        ("position_mm = 0.0", "rides_on = 4", "rides_on: .*an element from 1 to 3, got 4"),
        ("thickness_mm = [3.5]", "thickness_mm = true", "expected a number for 'thickness_mm'"),
    ],
)
def test_bad_files_are_named_with_their_place(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in PETZVAL
    path = tmp_path / "lens.toml"
    path.write_text(PETZVAL.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(DataError, match=message):
        load_lens(path)


def test_values_in_place_of_tables() -> None:
    head = "[stop]\ndiameter_mm = 1\n"
    with pytest.raises(DataError, match=r"lens: expected tables \[\[element\]\], got 5"):
        parse_lens("element = 5\n" + head)
    text = head + "[[element]]\nglass = 'N-BK7'\nthickness_mm = 1\ngap_mm = 1\nsurface = 5\n"
    with pytest.raises(DataError, match=r"element 1, line 3: expected tables \[\[surface\]\]"):
        parse_lens(text)
    with pytest.raises(DataError, match="stop: expected a table, got 3"):
        parse_lens("stop = 3\nelement = []\n")


def test_missing_and_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="expected a lens file or a name of al2550"):
        load_lens("petzval_c")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match="UTF-8"):
        load_lens(tmp_path / "binary.toml")
    with pytest.raises(DataError, match="cannot write"):
        save_lens(load_lens("petzval_a"), tmp_path / "missing" / "lens.toml")


def test_a_stop_in_glass_is_questioned() -> None:
    lens = load_lens("petzval_a")
    thick_mm = lens.elements[0].length_mm
    inside = replace(lens, stop=replace(lens.stop, position_mm=0.5 * thick_mm, diameter_mm=2.0))
    with pytest.warns(QualityWarning, match=f"stop at {0.5 * thick_mm:g} mm lies in element 1"):
        parse_lens(format_lens(inside))
