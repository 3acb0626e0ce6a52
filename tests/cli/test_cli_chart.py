"""`lensshift evaluate chart`, and photographs in `evaluate mtf`."""

import json
import runpy
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.special import ndtr
from stand_in import Call, Refused

LENS = runpy.run_path(str(Path(__file__).resolve().parents[2] / "examples" / "measure_lens.py"))
SIDE = LENS["TILE_PX"]
TRUE_SIGMA_PX = np.hypot(0.6, 0.29)
TRUE_CPP = np.sqrt(np.log(2.0) / 2.0) / np.pi / TRUE_SIGMA_PX


ALL, ONE_EDGE = (0, 0, SIDE, SIDE), (0, 30, 55, 90)


def save_square(
    path: Path,
    *,
    gamma: float = 2.2,
    sigma_px: float = 0.6,
    cut: tuple[int, int, int, int] = ALL,
) -> None:
    """Write a photograph of one slanted square; its round blur makes every edge alike."""
    light = LENS["square"](7.0, sigma_px, sigma_px, 0.0)
    light = light + np.random.default_rng(0).normal(0.0, 0.002, light.shape)
    levels = np.rint(255 * np.clip(light, 0, 1) ** (1 / gamma)).astype("u1")
    Image.fromarray(levels).crop(cut).save(path, quality=98)


def test_a_photograph_to_numbers_a_table_a_page_and_a_picture(call: Call, tmp_path: Path) -> None:
    save_square(tmp_path / "photo.jpg")
    page, table, seen = tmp_path / "lens.html", tmp_path / "edges.csv", tmp_path / "seen"
    done = call(
        "evaluate", "chart", tmp_path / "photo.jpg", "--gamma", "2.2", "--pitch-mm", "0.005",
        "--at", "40", "--report", page, "--csv", table, "--annotate", seen, "--json",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["unit"] == "LP/mm"
    assert len(told["edges"]) == 4
    for one in told["edges"]:
        assert one["mtf50"] == pytest.approx(TRUE_CPP / 0.005, rel=0.03)
    assert 0 < told["acutance"]["photo.jpg"] < 1
    rows = np.genfromtxt(table, delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert len(rows) == 4
    assert rows["mtf50_lp_per_mm"][0] == pytest.approx(told["edges"][0]["mtf50"])
    assert rows["mtf_at_40"][0] == pytest.approx(told["edges"][0]["mtf_at_40"])
    html = page.read_text(encoding="utf-8")
    assert "sagittal" in html
    assert "src=" not in html.replace('src="data:', "")  # nothing from elsewhere
    with Image.open(seen / "photo_edges.png") as picture:
        assert picture.size[0] > 500


def test_photographs_of_one_name_are_drawn_apart(call: Call, tmp_path: Path) -> None:
    names = [tmp_path / folder / "photo.png" for folder in ("left", "right")]
    for name in names:
        name.parent.mkdir()
        save_square(name, cut=ONE_EDGE)
    seen = tmp_path / "seen"
    done = call("evaluate", "chart", *names, "--gamma", "2.2", "--workers", 1, "--annotate", seen)
    assert done.exit_code == 0, done.output
    assert len(list(seen.iterdir())) == 2


@pytest.mark.slow
def test_through_focus(call: Call, tmp_path: Path) -> None:
    names = []
    for place, sigma_px in ((0, 1.0), (10, 0.6), (20, 1.0)):
        names.append(tmp_path / f"at_{place}.png")
        save_square(names[-1], gamma=1.0, sigma_px=sigma_px)
    # In this process: others would take longer to start than the twelve edges take.
    told = "--focus", "0,10,20", "--focus-unit", "um", "--workers", 1, "--json"
    done = call("evaluate", "chart", *names, *told)
    assert done.exit_code == 0, done.output
    for fit in json.loads(done.stdout)["best_focus"].values():
        assert fit["focus"] == pytest.approx(10.0, abs=0.3)


def test_mtf_of_a_photograph_at_frequencies(call: Call, tmp_path: Path) -> None:
    save_square(tmp_path / "photo.png")
    region = f"{SIDE // 2 - 20},{SIDE // 2 + 20},5,45"
    done = call("evaluate", "mtf", tmp_path / "photo.png", "--gamma", "2.2", "--region", region,
                "--at", "0.1", "--at", "0.25", "--at", "9", "--json")  # fmt: skip
    assert done.exit_code == 0, done.output
    [edge] = json.loads(done.stdout)["edges"]
    for one in edge["at"][:2]:
        expected = np.exp(-2 * (np.pi * TRUE_SIGMA_PX * one["frequency"]) ** 2)
        assert one["value"] == pytest.approx(expected, abs=0.02)
        assert one["low"] <= one["value"] <= one["high"]
    assert edge["at"][2]["value"] is None
    linear = call("evaluate", "mtf", tmp_path / "photo.png", "--region", region, "--json")
    bent = json.loads(linear.stdout)["edges"][0]["mtf50"]["value"]
    assert abs(bent / TRUE_CPP - 1) > abs(edge["mtf50"]["value"] / TRUE_CPP - 1)


def test_the_curve_has_the_frequency_that_is_asked_for(call: Call, tmp_path: Path) -> None:
    """A ghost makes it wave: between its steps of 0.01 cycles a pixel it was 0.02 off."""
    row, col = (np.arange(n) - (n - 1) / 2 for n in (60, 90))
    place = col * np.cos(0.12) + row[:, None] * np.sin(0.12)
    light = 0.82 * ndtr(place / 0.8) + 0.18 * ndtr((place - 15.3) / 0.8)
    light += np.random.default_rng(4).normal(0.0, 0.001, light.shape)
    np.save(tmp_path / "ghost.npy", 0.1 + 0.8 * light)
    table = tmp_path / "mtf.csv"
    done = call("evaluate", "mtf", tmp_path / "ghost.npy", "--region", "0,60,0,90",
                "--at", "0.095", "--at", "0.3", "--csv", table, "--json")  # fmt: skip
    assert done.exit_code == 0, done.output
    rows = json.loads(done.stdout)["edges"][0]["at"]
    for one in rows:
        f = one["frequency"]
        core = np.exp(-2 * (np.pi * 0.8 * f) ** 2)
        expected = core * abs(0.82 + 0.18 * np.exp(-2j * np.pi * 15.3 * f))
        assert one["value"] == pytest.approx(expected, abs=0.003)
    curve = np.genfromtxt(table, delimiter=",", names=True)
    assert len(curve) == 102  # a step beside 0.3 would be the same


def test_a_jpeg_of_unknown_curve_is_questioned(call: Call, tmp_path: Path) -> None:
    save_square(tmp_path / "photo.jpg")
    done = call("evaluate", "mtf", tmp_path / "photo.jpg", "--region", "40,80,5,45")
    assert "--gamma 2.2" in " ".join(done.stderr.split())


def test_what_a_jpeg_cut_off_counts_in_its_intervals(call: Call, tmp_path: Path) -> None:
    """The same pixels as PNG have the same MTF50, known too well."""
    jpeg, png = tmp_path / "coded.jpg", tmp_path / "photo.png"
    save_square(png, cut=ONE_EDGE)
    with Image.open(png) as photo:
        photo.save(jpeg, quality=60)
    with Image.open(jpeg) as coded:
        coded.save(png)
    values, widths = [], []
    for path in (jpeg, png):
        region = ("--region", "10,50,5,45")
        done = call("evaluate", "mtf", path, *region, "--gamma", "2.2", "--json")
        half = json.loads(done.stdout)["edges"][0]["mtf50"]
        done = call("evaluate", "chart", path, "--workers", "1", "--gamma", "2.2", "--json")
        row = json.loads(done.stdout)["edges"][0]
        values.append((half["value"], row["mtf50"]))
        widths.append((half["high"] - half["low"], row["mtf50_high"] - row["mtf50_low"]))
    assert values[0] == values[1]
    assert np.all(np.array(widths[0]) > 1.1 * np.array(widths[1]))
    call("evaluate", "mtf", jpeg, "--method", "sfrmat3")  # has no intervals


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--gamma", "2.2", "--oecf", "x.csv"], 2, "not both"),
        (["--gamma", "-1"], 2, "2.2; got -1"),
        (["--bayer", "RGBW"], 1, "expected a pattern of RGGB"),
        (["--channel", "red"], 1, "this one is grey"),
        (["--focus", "1,2"], 2, "a focus for each of 1 photographs"),
        (["--focus", "nan"], 2, "a focus for each of 1 photographs"),
        (["--at", "nan"], 2, "greater than or equal to 0"),
        (["--at", "-1"], 2, "greater than or equal to 0"),
        (["--order", "3"], 1, "order"),
        (["--pitch-mm", "0"], 2, "a pitch like 0.1"),
        (["--csv", "photo.png"], 2, "photo.png"),
        (["--bayer", "RGBW", "--csv", "none/edges.csv"], 1, "no folder"),  # before the work
        (["--bayer", "RGBW", "--report", "none/lens.html"], 1, "no folder"),
    ],
)
def test_wrong_arguments(
    refused: Refused, tmp_path: Path, options: list[str], code: int, message: str
) -> None:
    save_square(tmp_path / "photo.png")
    refused(["evaluate", "chart", "photo.png", *options], code, message)
