"""`lensshift lens`."""

import re
from pathlib import Path

import numpy as np
import pytest
from stand_in import Call, Refused, answer

from lensshift.core.grid import Grid
from lensshift.io import load_burst, load_lens_field
from lensshift.optics.lens import Element, Lens, Stop, Surface
from lensshift.optics.lens_file import load_lens, save_lens
from lensshift.optics.spots import spots
from lensshift.optics.which import edge_fields


def numbers(call: Call, *arguments: object) -> dict[str, object]:
    return answer(call, "lens", *arguments)


def test_show_tells_the_published_data(call: Call) -> None:
    found = numbers(call, "show", "petzval_a")
    assert found["focal_length_mm"] == pytest.approx(42.7, abs=0.005)
    assert found["entrance_pupil_diameter_mm"] == pytest.approx(20.0)
    assert found["magnification"] == pytest.approx(-0.01246, abs=1e-5)
    assert found["travel_mm"] == pytest.approx([0.0444, 0.0444], abs=1e-4)
    assert len(found["elements"]) == 3  # type: ignore[arg-type]
    text = call("lens", "show", "petzval_a").stdout
    assert "travel for 0.25 px" in text
    assert "44.38 um of element 1" in text


def test_wavelength_and_temperature_change_the_lens(call: Call) -> None:
    red, infrared = (
        numbers(call, "show", "petzval_a", "--wavelength-nm", nm)["focal_length_mm"]
        for nm in ("650", "940")
    )
    assert red < infrared  # type: ignore[operator]
    cold, warm = (
        numbers(call, "show", "petzval_a", "--temperature-c", c)["focal_length_mm"]
        for c in ("0", "40")
    )
    assert cold != warm


def test_a_lens_is_shown_where_its_image_cannot_move_so_far(call: Call, tmp_path: Path) -> None:
    """A quarter of a pixel is three times its diameter."""
    lens = tmp_path / "ball.toml"
    edges = (Surface(radius_mm, semi_diameter_mm=0.006) for radius_mm in (0.01, -0.01))
    ball = Element(tuple(edges), ("N-SF11",), (0.02,))
    save_lens(Lens((ball,), (0.002,), Stop(0.004)), lens)
    found = numbers(call, "show", lens)
    assert found["focal_length_mm"] == pytest.approx(0.0116, abs=1e-4)
    assert found["travel_mm"] is None
    told = call("lens", "show", lens).stdout
    assert (
        "travel for 0.25 px          none, with pixels of 0.155 mm (--pitch-mm): expected" in told
    )
    assert call("lens", "show", lens, "--plot", tmp_path / "ball.png").exit_code == 1


WINDOW_FIRST = """
name = "window first"
[stop]
diameter_mm = 5.0
position_mm = -10.0
[[element]]
name = "window"
glass = ["N-BK7"]
thickness_mm = [1.0]
gap_mm = 5.0
surface = [{radius_mm = inf}, {radius_mm = inf}]
[[element]]
glass = ["N-SF11"]
thickness_mm = [2.0]
gap_mm = 15.55
surface = [{radius_mm = 25.0}, {radius_mm = -25.0}]
"""


def test_what_moves_is_the_first_element_that_can(call: Call, tmp_path: Path) -> None:
    """A window in front moves no image; behind it a thin lens moves it nearly by its own travel."""
    lens = tmp_path / "window.toml"
    lens.write_text(WINDOW_FIRST)
    odd = ("--sensor", "13x9", "--pitch-mm", "0.07,0.045")
    found = numbers(call, "show", lens, *odd)
    assert found["element"] == 2
    told = call("lens", "show", lens, *odd).stdout
    away_mm = 15.55 - float(str(found["image_mm"]))
    assert f"sensor                      15.55 mm, {away_mm:+.4g} mm from the image" in told
    assert "um of element 2 along columns" in told
    assert numbers(call, "budget", lens, *odd)["element"] == 2
    field = numbers(call, "field", lens, *odd)
    assert field["element"] == 2
    travel_mm = np.array(field["travel"])
    assert np.abs(travel_mm[0] / (0.25 * np.array([0.07, 0.045]))) == pytest.approx(1.0, abs=0.05)
    told = call("lens", "field", lens, *odd, "--element", "0").stdout
    assert told.startswith("window first, shift of the sensor, 13 x 9 pixels of 0.07 x 0.045 mm")


def test_a_lens_out_of_focus_is_told(call: Call, tmp_path: Path) -> None:
    away = tmp_path / "away.toml"
    lens = load_lens("al2550")
    save_lens(lens.with_sensor(lens.gaps_mm[-1] - 20.0), away)
    said = re.compile(
        r"out of focus, with a spot of \d[^ ]* px rms in the middle.* lies \+(\d+)\S* mm"
    )
    for verb in ("mtf", "which", "budget"):
        found = said.search(" ".join(call("lens", verb, away).stderr.split()))
        assert found is not None
        assert 18 < int(found[1]) < 22
    assert "out of focus" not in call("lens", "mtf", "al2550").stderr


def test_mtf_is_below_the_diffraction_limit(call: Call, tmp_path: Path) -> None:
    found = numbers(call, "mtf", "petzval_a", "--csv", tmp_path / "mtf.csv", "--fast")
    limit = np.array(found["diffraction_limit"])
    assert len(found["mtf"]) == 8  # type: ignore[arg-type]
    for values in found["mtf"].values():  # type: ignore[attr-defined]
        assert values[0] == pytest.approx(1.0)
        assert np.all(np.array(values) <= limit + 1e-3)
    table = np.genfromtxt(tmp_path / "mtf.csv", delimiter=",", names=True)
    assert table["frequency_lpmm"][-1] == pytest.approx(2.5 * 0.5 / 0.155)
    exact = numbers(call, "mtf", "petzval_a", "--field-deg", "0,0", "--highest-lpmm", "6.5")
    rest = np.interp(6.452, exact["frequency_lpmm"], next(iter(exact["mtf"].values())))  # type: ignore[attr-defined]
    assert rest == pytest.approx(0.960, abs=0.003)


def test_mtf_through_focus_is_drawn(call: Call, tmp_path: Path) -> None:
    plot = tmp_path / "focus.svg"
    numbers(call, "mtf", "petzval_a", "--fast", "--figure", "focus", "--plot", plot)
    drawn = plot.read_text()
    assert "Petzval A through focus" in drawn
    assert "modulation at 6.45 LP/mm" in drawn


def test_field_moves_the_centre_by_what_was_asked(call: Call, tmp_path: Path) -> None:
    out, table, plot = (tmp_path / name for name in ("field.nc", "field.csv", "field.svg"))
    wanted = "--element", "2", "--sensor", "9x5", "--pitch-mm", "0.3", "--pattern", "3x3"
    found = numbers(call, "field", "petzval_b", *wanted, "-o", out, "--csv", table, "--plot", plot)
    shown = load_lens_field(out).at(found["travel"])
    assert shown.offset_px.shape == (9, 5, 9, 2)
    assert shown.offset_px[:, 2, 4] == pytest.approx(np.array(found["wanted_px"]), abs=1e-8)
    assert np.genfromtxt(table, delimiter=",", names=True)["offset_row_px"].shape == (9 * 45,)
    assert found["shift_error_px"] < 1e-6  # type: ignore[operator]
    assert "Petzval B, decentre of element 2, 9 x 5 pixels" in call("info", out).stdout
    assert "fit: shift" in call("lens", "field", "petzval_b", *wanted[:6]).stdout


@pytest.mark.parametrize("pattern", ["square", "3x3"])
def test_field_is_for_bursts_of_its_lens(call: Call, tmp_path: Path, pattern: str) -> None:
    small, burst, out = tmp_path / "small.toml", tmp_path / "b.nc", tmp_path / "field.nc"
    small.write_text("[camera.grid]\nshape = [5, 9]\npitch_mm = [0.3, 0.3]\n")
    taken = "--camera", small, "--lens", "petzval_b", "--pattern", pattern, "--shift-error-px", "0"
    assert call("simulate", "slanted_edge", *taken, "-o", burst).exit_code == 0
    assert call("lens", "field", "petzval_b", "--burst", burst, "-o", out).exit_code == 0
    with np.load(tmp_path / "b.truth.npz") as truth:
        true_px = truth["offset_field_px"]
    field_px = load_lens_field(out).of(load_burst(burst)).offset_px
    np.testing.assert_allclose(field_px, true_px, atol=2e-3)
    usual = "reconstruct", burst, "--method", "bicubic", "--lens-field", out
    assert call(*usual).exit_code == 0
    other = "field", "petzval_b", "--burst", burst, "--element", 2
    assert call("lens", *other, "-o", out).exit_code == 0
    refused = call(*usual)
    assert refused.exit_code == 1
    assert "field.nc: " in refused.output
    assert "make it with --element 1" in " ".join(refused.output.split())


def test_which_compares_all_elements(call: Call, tmp_path: Path) -> None:
    sensor = "--sensor", "8x3", "--pitch-mm", "1.2,0.8"
    found = numbers(call, "which", "petzval_a", "--csv", tmp_path / "which.csv", *sensor)
    rows = found["movers"]
    assert [row["element"] for row in rows if row["kind"] == "decentre"] == [1, 2, 3]  # type: ignore[attr-defined]
    assert rows[-1]["kind"] == "sensor"  # type: ignore[index]
    table = np.genfromtxt(tmp_path / "which.csv", delimiter=",", names=True, dtype=None)
    assert table["stroke_mm"].shape == (len(rows),)  # type: ignore[arg-type]


@pytest.mark.slow
def test_light_that_is_lost_is_told_once_for_the_field_that_loses_most(
    call: Call, tmp_path: Path
) -> None:
    front = Surface(20.0, semi_diameter_mm=3.2)
    glass = Element((front, Surface(-30.0, semi_diameter_mm=3.2)), ("N-BK7",), (3.0,), name="a")
    lens = Lens((glass,), (22.5,), Stop(6.0, -8.0))
    save_lens(lens, tmp_path / "cut.toml")
    sensor = "--sensor", "80x30", "--pitch-mm", 0.155
    (said,) = numbers(call, "which", tmp_path / "cut.toml", *sensor)["warnings"]  # type: ignore[misc]
    lost = 1.0 - spots(lens, edge_fields(lens, Grid((30, 80), (0.155, 0.155)))).transmission.min()
    percent = re.search(r"degrees \(row / column\) loses (\d+) % of its light", said)
    assert percent is not None
    assert 100 * lost - 0.5 < int(percent[1]) < 100 * lost + 15  # moved, a little more
    assert "most of it at surface 1 (surface 1 of a)" in said


def test_report_tells_and_draws_all(call: Call, tmp_path: Path) -> None:
    page, sensor = tmp_path / "page.html", ("--sensor", "62x13", "--pitch-mm", "0.2,0.155")
    found = numbers(call, "report", "petzval_a", *sensor, "--band-nm", "40")
    middle, _, corner = found["fields"]  # type: ignore[misc]
    assert middle["illumination (%)"] == pytest.approx(100.0)
    assert corner["light in half a pixel (%)"] < corner["light in a pixel (%)"] < 100.0
    assert corner["MTF T at 5 LP/mm"] < corner["MTF T at 2.5 LP/mm"] < 1.0
    said = call("lens", "report", "al2550", "--sensor", "9x5", "-o", page)  # one element: quick
    assert "focus S behind the sensor" in said.stdout
    text = page.read_text()
    assert text.count("<img") == 8
    for words in ("AL2550", "petzval radius", "least MTF", "Where both sections"):
        assert words in text
    assert call("lens", "report", "petzval_a", "-o", tmp_path / "page.txt").exit_code == 2


@pytest.mark.parametrize("figure", ["layout", "spots", "fans", "psf", "field", "distortion"])
def test_show_draws(call: Call, tmp_path: Path, figure: str) -> None:
    plot = tmp_path / "lens.svg"
    numbers(call, "show", "petzval_a", "--figure", figure, "--plot", plot)
    assert plot.stat().st_size > 5000


def test_there_and_back_again(call: Call, tmp_path: Path) -> None:
    there, back = tmp_path / "lens.zmx", tmp_path / "lens.toml"
    assert call("lens", "convert", "petzval_b", there).exit_code == 0
    assert call("lens", "convert", there, back).exit_code == 0
    first, second = (numbers(call, "show", name) for name in ("petzval_b", back))
    assert second["focal_length_mm"] == pytest.approx(first["focal_length_mm"], abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["show", "nope"], 1, "expected a lens file or a name of al2550"),
        (["show", "petzval_a", "--element", "4"], 2, "an element from 1 to 3, got 4"),
        (["show", "petzval_a", "--wavelength-nm", "3000"], 1, "expected a wavelength from"),
        (["mtf", "petzval_a", "--field-deg", "6.5"], 2, "a field like 1.6,6.5"),
        (["mtf", "petzval_a", "--field-deg", "0,60"], 1, "ray"),
        (["field", "petzval_a", "--sensor", "64"], 2, "a sensor like 64x16"),
        (["field", "petzval_a", "--element", "4"], 2, "an element from 1 to 3, got 4"),
        (["field", "petzval_a", "--element", "0", "--tilt"], 2, "--tilt is of an element"),
        (["field", "petzval_a", "--reach-px", "90"], 1, ""),
        (["field", "petzval_a", "--reach-px", "0.1"], 2, "the 0.25 px of the pattern square"),
        (["field", "petzval_a", "--burst", "none.nc"], 1, "none.nc"),
        (["field", "petzval_a", "--burst", "b.nc", "--sensor", "9x5"], 2, "give one of both"),
        (["field", "petzval_a", "-o", "field.npz"], 2, "netCDF file"),
        (["field", "lens.toml", "--csv", "lens.toml"], 2, "would overwrite the input"),
        (["mtf", "lens.toml", "--csv", "lens.toml"], 2, "would overwrite the input"),
        (["which", "lens.toml", "--csv", "./lens.toml"], 2, "would overwrite the input"),
        (["convert", "petzval_a", "lens.txt"], 2, "to end in .toml or .zmx"),
    ],
)
def test_wrong_arguments(refused: Refused, arguments: list[str], code: int, message: str) -> None:
    refused(["lens", *arguments], code, message)


def test_a_catalogue_brings_its_glass_into_the_lens_file(call: Call, tmp_path: Path) -> None:
    catalogue, lens, file = (tmp_path / name for name in ("own.agf", "lens.zmx", "lens.toml"))
    catalogue.write_text("NM MADE-UP 2\nCD 1.2 0.01 0.2 0.02 1.0 100\nLD 0.4 2.0\n")
    assert call("lens", "convert", "al2550", lens).exit_code == 0
    lens.write_text(lens.read_text().replace("N-BK7", "MADE-UP"))
    assert "--glass-catalogue" in call("lens", "convert", lens, file).output
    done = call("lens", "convert", lens, file, "--glass-catalogue", catalogue)
    assert done.exit_code == 0
    assert 'name = "MADE-UP"' in file.read_text()
    missing = call("lens", "convert", lens, file, "--glass-catalogue", tmp_path / "none.agf")
    assert missing.exit_code != 0
