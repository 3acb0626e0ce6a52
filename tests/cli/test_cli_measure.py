"""`lensshift evaluate gain`, `gradient`, `star`, `zone`, `frc` and `depth`."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL.Image import fromarray
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr
from stand_in import Call, Refused, answer

from lensshift import reconstruct, save_reconstruction
from lensshift.cli import outputs
from lensshift.core.calibration import Calibration
from lensshift.core.motion import StageMap
from lensshift.core.types import Burst
from lensshift.io import save_burst
from lensshift.io.calibration_file import load_calibration, save_calibration

Image = NDArray[np.float64]
SHAPE = (16, 40)


def edge(scale: int = 1, sigma_px: float = 0.8, noise: float = 0.005) -> Image:
    """Return an edge seen by LR pixels (or by pixels `scale` times finer), with a little noise."""
    rows, cols = SHAPE[0] * scale, SHAPE[1] * scale
    row = (np.arange(rows) + 0.5) / scale - SHAPE[0] / 2
    col = (np.arange(cols) + 0.5) / scale - SHAPE[1] / 2
    normal = col * np.cos(0.15) + row[:, None] * np.sin(0.15)
    image = 0.2 + 0.6 * ndtr(normal / sigma_px)
    return image + noise * np.random.default_rng(scale).standard_normal(image.shape)


def numbers(call: Call, *arguments: object) -> dict[str, object]:
    return answer(call, "evaluate", *arguments)


def table(path: Path) -> NDArray[np.void]:
    return np.atleast_1d(np.genfromtxt(path, delimiter=",", names=True))


def test_gain_of_half_the_blur_is_two(call: Call, tmp_path: Path) -> None:
    np.save(tmp_path / "coarse.npy", edge())
    np.save(tmp_path / "fine.npy", edge(2, sigma_px=0.4))
    files = tmp_path / "fine.npy", tmp_path / "coarse.npy"
    found = numbers(call, "gain", *files, "--csv", tmp_path / "gain.csv", "--pitch-mm", "0.1")
    assert found["scale"] == 2
    assert found["unit"] == "LP/mm"
    for name in ("mtf50", "mtf10", "width"):
        ratio = found["gain"][name]  # type: ignore[index]
        assert ratio["value"] == pytest.approx(2.0, rel=0.05)
        assert ratio["low"] < ratio["value"] < ratio["high"]
    assert table(tmp_path / "gain.csv")["mtf50"][0] == pytest.approx(2.0, rel=0.05)
    fine = found["edges"][0]["fine"]  # type: ignore[index]
    assert fine["mtf50_lpmm"]["value"] == pytest.approx(1.874 / 0.4, rel=0.05)


def test_gain_speaks_of_regions_in_pixels_of_the_coarse_image(
    call: Call, refused: Refused, tmp_path: Path
) -> None:
    np.save(tmp_path / "coarse.npy", edge())
    np.save(tmp_path / "fine.npy", edge(2, sigma_px=0.4))
    verb = "evaluate", "gain", tmp_path / "fine.npy", tmp_path / "coarse.npy", "--region"
    refused([*verb, "0,16,0,80"], 1, "within 16 rows and 40 columns, got (0, 16, 0, 80)")
    warned = json.loads(call(*verb, "0,16,18,22", "--json").stdout)["warnings"]
    assert f"{tmp_path / 'coarse.npy'}: edge in rows 0:16, columns 18:22" in " ".join(warned)
    assert all(text.startswith(str(tmp_path)) for text in warned), warned


def test_gain_knows_how_far_a_frame_moved(call: Call, tmp_path: Path) -> None:
    frames = np.stack([edge(), np.roll(edge(), 3, axis=1)])
    moved = np.array([[0.0, 0.0], [0.0, 3.0]])
    for name, offset_px in (("burst", moved), ("untold", np.zeros((2, 2)))):
        save_burst(Burst.from_arrays(frames, offset_px=offset_px), tmp_path / f"{name}.nc")
    np.save(tmp_path / "fine.npy", edge(2, sigma_px=0.4))
    verb = "evaluate", "gain", tmp_path / "fine.npy"
    at = "--region", "0,16,4,36", "--json"
    for file, frame, words in (("burst", 0, 0), ("burst", 1, 0), ("untold", 1, 1)):
        done = call(*verb, tmp_path / f"{file}.nc", "--frame", str(frame), *at)
        told = [
            one for one in json.loads(done.stdout)["warnings"] if "3.0 px of the coarser" in one
        ]
        assert len(told) == words


def test_frequencies_in_the_scene(call: Call, tmp_path: Path) -> None:
    np.save(tmp_path / "edge.npy", edge())
    wanted = "mtf", tmp_path / "edge.npy", "--pitch-mm", "0.1"
    plain = numbers(call, *wanted)
    scene = numbers(call, *wanted, "--focal-length-mm", "50")
    assert scene["unit"] == "cycles/mrad"
    half, half_there = (found["mean"]["mtf50"]["value"] for found in (plain, scene))  # type: ignore[index]
    assert half_there == pytest.approx(0.05 * half)


def test_gradient_of_a_gaussian_edge(call: Call, tmp_path: Path) -> None:
    np.save(tmp_path / "edge.npy", edge(noise=0.0))
    np.save(tmp_path / "fine.npy", edge(2, sigma_px=0.4, noise=0.0))
    wanted = "gradient", tmp_path / "edge.npy", "--pitch-mm", "0.1"
    found = numbers(call, *wanted, "--csv", tmp_path / "lines.csv")
    width_mm = 2 * 1.2816 * 0.08 / np.cos(0.15)  # 10-90, along the rows
    slope = found["gradient"]
    assert slope["averaged_width_mm"] == pytest.approx(width_mm, rel=0.05)  # type: ignore[index]
    assert len(table(tmp_path / "lines.csv")) == SHAPE[0]
    against = "--against", tmp_path / "edge.npy", "--pitch-mm", "0.1"
    ratio = numbers(call, "gradient", tmp_path / "fine.npy", *against)["ratio"]
    assert ratio["averaged"] == pytest.approx(2.0, rel=0.06)  # type: ignore[index]


def test_one_line_is_doubted(call: Call, tmp_path: Path) -> None:
    np.save(tmp_path / "edge.npy", edge())
    done = call("evaluate", "gradient", tmp_path / "edge.npy", "--line", "3")
    assert "one line profile cannot measure a gain of 2" in done.stderr
    assert "1 line\n" in done.stdout


def star(cycles: int = 12) -> Image:
    row, col = np.indices((61, 71), dtype=float)
    return 0.5 + 0.4 * np.cos(cycles * np.arctan2(row - 30.2, col - 34.6))


def test_star_without_blur_has_contrast_one(call: Call, tmp_path: Path) -> None:
    np.save(tmp_path / "star.npy", star())
    wanted = "star", tmp_path / "star.npy", "--cycles", "12", "--levels", "0.1,0.9"
    found = numbers(call, *wanted, "--sectors", "4", "--csv", tmp_path / "star.csv")
    assert found["center_px"] == pytest.approx([30.2, 34.6], abs=0.02)
    curve = found["curves"][0]  # type: ignore[index]
    assert np.array(curve["modulation"]) == pytest.approx(1.0, abs=0.02)
    assert len(found["curves"]) == 5  # type: ignore[arg-type]
    dead = star()
    dead[3:9, 40:60] = np.nan  # as pixels of an edge they are left out, not refused
    np.save(tmp_path / "star.npy", dead)
    kept = numbers(call, *wanted)["curves"][0]  # type: ignore[index]
    assert np.array(kept["modulation"]) == pytest.approx(1.0, abs=0.02)
    assert table(tmp_path / "star.csv")["frequency"].max() <= 0.5


def test_a_star_is_measured_in_one_channel_of_linear_light(call: Call, tmp_path: Path) -> None:
    """Red is sharp, green blurred, blue curved by a gamma of 2.2."""
    sharp = star(20)
    light = np.stack([sharp, gaussian_filter(sharp, 1.0), sharp ** (1 / 2.2)], axis=-1)
    fromarray(np.rint(255 * light).astype(np.uint8)).save(tmp_path / "star.png")
    wanted = "star", tmp_path / "star.png", "--cycles", "20", "--center-px", "30.2,34.6"
    contrast = {}
    for name, more in (("red", ()), ("green", ()), ("blue", ("--gamma", "2.2"))):
        found = numbers(call, *wanted, "--levels", "25.5,229.5", "--channel", name, *more)
        contrast[name] = np.median(found["curves"][0]["modulation"])  # type: ignore[index]
    assert contrast["red"] == pytest.approx(1.0, abs=0.02)
    assert contrast["blue"] == pytest.approx(1.0, abs=0.02)
    assert contrast["green"] < 0.7


def test_zone_plate_without_blur_has_contrast_one(call: Call, tmp_path: Path) -> None:
    row, col = np.indices((71, 61), dtype=float)
    plate = 0.5 + 0.4 * np.cos(np.pi * 0.012 * ((row - 35.1) ** 2 + (col - 30.3) ** 2))
    np.save(tmp_path / "zone.npy", plate)
    wanted = "zone", tmp_path / "zone.npy", "--chirp", "0.012", "--levels", "0.1,0.9"
    found = numbers(call, *wanted)
    assert found["center_px"] == pytest.approx([35.1, 30.3], abs=0.02)
    assert [curve["name"] for curve in found["curves"]] == ["radial", "row", "col"]  # type: ignore[attr-defined]
    for curve in found["curves"]:  # type: ignore[attr-defined]
        assert np.array(curve["modulation"]) == pytest.approx(1.0, abs=0.02)


def test_a_key_is_for_the_file_that_has_names(call: Call, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    np.save(tmp_path / "one.npy", rng.standard_normal((40, 40)))
    np.savez(tmp_path / "other.npz", a=rng.standard_normal((40, 40)), b=np.zeros((40, 40)))
    done = call("evaluate", "frc", tmp_path / "one.npy", tmp_path / "other.npz", "--key", "a")
    assert done.exit_code == 0, done.output


def test_pictures_of_other_pixels_are_not_compared(
    call: Call, refused: Refused, tmp_path: Path
) -> None:
    """The pitch of one was taken for both, or LP/mm were held against cycles per pixel."""
    np.save(tmp_path / "plain.npy", edge())
    np.save(tmp_path / "fine.npy", edge(2, sigma_px=0.4))
    files = {pitch: tmp_path / f"{pitch}.nc" for pitch in (0.1, 0.1005, 0.2)}
    for pitch, path in files.items():
        frames = np.stack(2 * [edge(noise=0.02 * pitch)])  # two captures, not one twice
        save_burst(Burst.from_arrays(frames, offset_px=np.zeros((2, 2)), pitch_mm=pitch), path)
    one, alike, other = files.values()
    beside = "--cycles", "9", "--edge"
    for verb, message in (
        (("gain", other, one), "those of the coarser image by 1"),
        (("gain", other, tmp_path / "plain.npy", "--pitch-mm", "0.1"), "of one burst?"),
        (("gradient", other, "--against", one), "0.2 x 0.2 mm and of 0.1 x 0.1 mm"),
        (("frc", one, other), "(those of SECOND)"),
        (("resolution", one, *beside, tmp_path / "plain.npy"), "plain.npy is not known"),
        (("resolution", tmp_path / "plain.npy", *beside, one), "plain.npy is not known"),
        (("resolution", one, *beside, other), "(those of --edge)"),
    ):
        refused(["evaluate", *verb], 1, message)
    assert call("evaluate", "gain", alike, one).exit_code == 0
    fine = "gain", tmp_path / "fine.npy", one
    assert numbers(call, *fine)["unit"] == "LP/mm"


def test_figures_show_the_lr_pixel_and_the_coarser_image(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pixel of the picture stood for that of the frames, and --against was not drawn."""
    told: dict[str, dict[str, Any]] = {}
    monkeypatch.setattr(outputs, "write_plot", lambda *of, **how: told.update({of[2]: how}))
    row_mm, col_mm = 0.2 * (np.indices((31, 37)) - np.array([15.0, 18.0])[:, None, None])
    plate = 0.5 + 0.4 * np.cos(np.pi * 0.8 * (row_mm**2 + col_mm**2))
    for verb, image, wave in (
        ("star", star()[::2, ::2], "--cycles=12"),
        ("zone", plate, "--chirp=0.8"),
    ):
        burst = Burst.from_arrays(image[None], offset_px=np.zeros((1, 2)), pitch_mm=0.2)
        result = reconstruct(burst, scale=2, method="nearest")
        save_reconstruction(result, tmp_path / f"{verb}.nc")
        done = call("evaluate", verb, tmp_path / f"{verb}.nc", wave)
        assert done.exit_code == 0, done.output
    for name in ("stars.star_figure", "stars.zone_plate_figure"):
        assert told[name]["lr_pitch_mm"] == pytest.approx((0.2, 0.2))
    np.save(tmp_path / "coarse.npy", edge())
    np.save(tmp_path / "fine.npy", edge(2, sigma_px=0.4))
    call("evaluate", "gradient", tmp_path / "fine.npy", "--against", tmp_path / "coarse.npy")
    assert told["gradient.gradient_figure"]["against"][1].shape == SHAPE


def test_noise_does_not_correlate(call: Call, tmp_path: Path) -> None:
    for seed in (1, 2):
        frame = edge() + np.random.default_rng(seed).standard_normal(SHAPE)
        np.save(tmp_path / f"{seed}.npy", frame)
    found = numbers(call, "frc", tmp_path / "1.npy", tmp_path / "2.npy")
    assert np.mean(found["correlation"][4:]) == pytest.approx(0.0, abs=0.15)  # type: ignore[index]
    np.save(tmp_path / "edge.npy", edge())
    wanted = "resolution", tmp_path / "star.npy", "--edge", tmp_path / "edge.npy"
    np.save(tmp_path / "star.npy", star())
    found = numbers(call, *wanted, "--cycles", "12", "--levels", "0.1,0.9")
    assert found["verdict"] == "pattern flatters"  # no blur in the star
    assert found["difference"] < -0.1  # type: ignore[operator]


def test_bars_beside_an_edge(call: Call, tmp_path: Path) -> None:
    """Bars without a blur: their pixels alone lower them, less than the edge's blur does it."""
    col = (np.arange(80 * 20) + 0.5) / 20
    lines = np.where(np.cos(2 * np.pi * col / 5.3) > 0, 0.9, 0.1).reshape(80, 20).mean(axis=1)
    np.save(tmp_path / "bars.npy", np.tile(lines, (30, 1)))
    np.save(tmp_path / "edge.npy", edge())
    wanted = "resolution", tmp_path / "bars.npy", "--edge", tmp_path / "edge.npy"
    found = numbers(call, *wanted, "--bars", "5.3px@0,30,0,80", "--levels", "0.1,0.9")
    assert found["verdict"] == "pattern flatters"
    assert found["contrast_std"] == 0.0
    pattern = next(one for one in found["curves"] if one["name"] == "pattern")  # type: ignore[attr-defined]
    assert pattern["modulation"] == pytest.approx([np.sinc(1 / 5.3)], abs=0.01)


def wall() -> Image:
    """Return radial distances of a plane 2 m away, seen with pixels of 0.1 mm and f = 40 mm."""
    row, col = ((np.arange(n) - 0.5 * (n - 1)) * 0.1 / 40 for n in SHAPE)
    return 2.0 * np.sqrt(1 + row[:, None] ** 2 + col**2)


def test_depth_against_the_truth(call: Call, tmp_path: Path) -> None:
    truth = wall()
    truth[:, 20:] += 0.5
    measured = truth + 0.01
    measured[:, 19] = 2.25  # between the surfaces
    np.save(tmp_path / "truth.npy", truth)
    np.save(tmp_path / "measured.npy", measured)
    files = tmp_path / "measured.npy", tmp_path / "truth.npy"
    found = numbers(call, "depth", *files, "--csv", tmp_path / "depth.csv", "--edge", "col")
    assert found["flat_rmse_m"] == pytest.approx(0.01)
    assert found["flying_fraction"] == pytest.approx(0.25)  # one of four columns near the edge
    error = measured - truth
    assert found["rmse_m"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert found["bias_m"] == pytest.approx(error.mean())
    assert "rmse_m," in (tmp_path / "depth.csv").read_text()
    assert found["edge_location"]["lines"] == SHAPE[0]  # type: ignore[index]


def test_depth_takes_the_distances_and_questions_what_are_none(call: Call, tmp_path: Path) -> None:
    np.savez(tmp_path / "both.npz", amplitude=np.ones(SHAPE), distance_m=wall())
    found = numbers(call, "depth", tmp_path / "both.npz", tmp_path / "both.npz")
    assert (found["rmse_m"], found["warnings"]) == (0.0, [])
    np.savez(tmp_path / "light.npz", amplitude=wall())
    assert numbers(call, "depth", tmp_path / "light.npz")["fill_rate"] == 1.0
    np.save(tmp_path / "levels.npy", 1000 * wall())
    (said,) = numbers(call, "depth", tmp_path / "levels.npy")["warnings"]
    assert "levels.npy: distance_m: expected metres" in said


def test_depth_alone(call: Call, tmp_path: Path) -> None:
    noise = 0.005 * np.random.default_rng(4).standard_normal((6, *SHAPE))
    burst = Burst.from_arrays(
        np.ones((6, *SHAPE)), wall() + noise, offset_px=np.zeros((6, 2)), pitch_mm=0.1
    )
    save_burst(burst, tmp_path / "burst.nc")
    plane = "--plane", "1,15,2,38", "--focal-length-mm", "40"
    found = numbers(call, "depth", tmp_path / "burst.nc", "--repeated", *plane)
    assert found["fill_rate"] == 1.0
    assert found["temporal_noise_m"] == pytest.approx(0.005, rel=0.05)
    assert found["plane"]["rms_m"] == pytest.approx(0.005, rel=0.1)  # type: ignore[index]
    assert abs(found["plane"]["normal"][2]) == pytest.approx(1.0, abs=1e-3)  # type: ignore[index]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["gain", "edge.npy", "odd.npy"], 1, "whole multiple"),
        (["gain", "edge.npy", "edge.npy", "--csv", "edge.npy"], 2, "would overwrite the input"),
        (["gain", "edge.npy", "edge.npy"], 1, "expected two images, got one twice"),
        (["gradient", "edge.npy", "--region", "0,99,0,9"], 1, "within 16 rows and 40 columns"),
        (["gradient", "edge.npy", "--share", "0.7"], 1, "a share above 0 and below 0.5"),
        (["gradient", "edge.npy", "--share", "0"], 1, "a share above 0 and below 0.5"),
        (["gradient", "edge.npy", "--line", "16"], 1, "a line from 0 to 15"),
        (["star", "edge.npy"], 2, "--cycles"),
        (["star", "edge.npy", "--cycles", "9", "--center-px", "1"], 2, "a centre like"),
        (["star", "edge.png", "--cycles", "9", "--bayer", "RGGB"], 2, "--channel red or blue"),
        (["zone", "edge.png", "--chirp", "0.01", "--channel", "red"], 1, "this one is grey"),
        (["zone", "edge.npy", "--chirp", "-1"], 1, "positive chirp"),
        (["frc", "edge.npy", "odd.npy"], 1, "shape"),
        (["frc", "edge.npy", "edge.npy"], 1, "one image twice"),
        (["resolution", "edge.npy"], 2, "--cycles of a star or --chirp of a zone plate"),
        (["resolution", "edge.npy", "--cycles", "9", "--bars", "8px"], 2, "one of them"),
        (["resolution", "edge.npy", "--bars", "wide"], 2, "bars like 2.5, 8px"),
        (["resolution", "edge.npy", "--cycles", "9", "--levels", "1"], 2, "levels like"),
        (["resolution", "edge.npy", "--bars", "8px"], 1, "expected levels, or 3 groups"),
        (["depth", "edge.npy", "odd.npy"], 1, "shape"),
        (["depth", "edge.npy", "--edge", "col"], 2, "needs the truth"),
        (["depth", "edge.npy", "--repeated"], 2, "--repeated needs a burst file"),
        (["depth", "edge.npy", "--plane", "0,9,0,9"], 2, "needs --focal-length-mm"),
        (["depth", "edge.npy", "edge.npy", "--min-step-m", "0"], 1, "a positive smallest step"),
        (["mtf", "edge.npy", "--focal-length-mm", "40"], 2, "needs the pitch"),
        (["mtf", "colours.npy"], 1, "got the colours of (16, 40, 3)"),
        (["mtf", "colours.png", "--bayer", "RGGB"], 1, "a raw mosaic, one number a pixel"),
        (["mtf", "missing.npy"], 1, "missing.npy"),
        (["mtf", "edge.npy", "--key", "distance"], 2, "arrays have names in NPZ and HDF5 files"),
        (["mtf", "edge.png", "--key", "distance"], 2, "arrays have names in NPZ and HDF5 files"),
        (["frc", "edge.npy", "odd.npy", "--key", "a"], 2, "not in edge.npy and odd.npy"),
        (["mtf", "edge.npy", "--plot", "edge.docx"], 1, "docx"),
    ],
)
def test_wrong_arguments(refused: Refused, arguments: list[str], code: int, message: str) -> None:
    np.save("edge.npy", edge())
    np.save("odd.npy", np.zeros((15, 33)))
    fromarray(np.uint8(200 * edge())).save("edge.png")
    np.save("colours.npy", np.stack([edge(), 0.8 * edge(), 0.5 * edge()], axis=2))
    fromarray(np.uint8(200 * np.load("colours.npy"))).save("colours.png")
    refused(["evaluate", *arguments], code, message)


def test_stray_light_is_measured_told_and_kept(
    call: Call, refused: Refused, tmp_path: Path
) -> None:
    card, empty, rig = (tmp_path / name for name in ("card.nc", "empty.nc", "rig.json"))
    rng = np.random.default_rng(4)
    for path, light in ((card, 2.0), (empty, 0.0)):
        x = np.full((4, 21, 34), 0.3)
        x[:, 8:12, 14:20] += light
        y = 0.98 * x + 0.02 * gaussian_filter(x, 4.0, axes=(1, 2), mode="reflect", truncate=8)
        y += 1e-3 * rng.standard_normal(y.shape)
        save_burst(Burst.from_arrays(y, offset_px=np.zeros((4, 2)), pitch_mm=0.1), path)
    found = numbers(call, "stray-light", card, empty)
    assert found["share"] == pytest.approx(0.02, rel=0.05)
    assert found["sigma_px"] == pytest.approx(4.0, rel=0.05)
    save_calibration(Calibration(StageMap(np.eye(2)), np.zeros(2)), rig)
    kept = numbers(call, "stray-light", card, empty, "--calibration", rig)
    known = load_calibration(rig)
    assert known.of_camera["stray_light"]["share"] == kept["share"] == found["share"]
    moved = Burst.from_arrays(
        np.ones((2, 5, 7)), offset_px=np.zeros((2, 2)), pitch_mm=0.1, stage_mm=np.ones((2, 2))
    )
    assert known.applied_to(moved)[0].meta["stray_light"] == known.of_camera["stray_light"]
    nothing = ["evaluate", "stray-light", empty, empty, "--calibration", rig]
    refused(nothing, 1, "bright object")
    told = answer(call, "reconstruct", card, "--stray-light", "0.02", "4", "0.001")
    assert told["channels"]["amplitude"]["status"]
    refused(["reconstruct", card, "--stray-light", "0.7", "4", "0.001"], 1, "stray_light.share")
