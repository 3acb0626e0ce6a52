"""`lensshift evaluate mtf`."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy.special import ndtr
from stand_in import Call, answer

from lensshift.core.types import Burst
from lensshift.io import export_image, save_burst

SIGMA_PX = 0.6
MTF50_CPP = np.sqrt(np.log(2) / 2) / np.pi / SIGMA_PX


def edge(offset_px: float = 0.0) -> np.ndarray:
    row, col = np.mgrid[:16, :40].astype(float)
    normal = (col - 19.5 - offset_px) * np.cos(0.15) + (row - 7.5) * np.sin(0.15)
    return 0.2 + 0.6 * ndtr(normal / SIGMA_PX)


def test_numbers_units_and_csv(call: Call, tmp_path: Path) -> None:
    np.save(tmp_path / "edge.npy", edge())
    plain = json.loads(call("evaluate", "mtf", tmp_path / "edge.npy", "--json").stdout)
    assert plain["unit"] == "cycles/px"
    found = plain["edges"][0]["mtf50_lpmm"]
    assert found["value"] == pytest.approx(MTF50_CPP, rel=0.005)
    assert found["low"] <= found["value"] <= found["high"]
    csv = tmp_path / "curve.csv"
    done = call("evaluate", "mtf", tmp_path / "edge.npy", "--pitch-mm", "0.1", "--csv", csv)
    assert "LP/mm" in done.stdout
    table = np.genfromtxt(csv, delimiter=",", names=True)
    assert table.dtype.names == ("frequency_lpmm", "modulation", "std")
    assert np.interp(10 * MTF50_CPP, table["frequency_lpmm"], table["modulation"]) == pytest.approx(
        0.5, abs=0.005
    )


@pytest.mark.parametrize("verb", ["mtf", "chart"])
@pytest.mark.parametrize("writer", ["ours", "imagej", "ome", "camera"])
def test_the_pitch_that_a_tiff_tells(call: Call, tmp_path: Path, verb: str, writer: str) -> None:
    name = "edge.ome.tif" if writer == "ome" else "edge.tif"
    path, image = tmp_path / name, edge().astype(np.float32)
    if writer == "ours":
        export_image(image, path, pitch_mm=(0.1, 0.1))
    elif writer == "ome":
        tifffile.imwrite(path, image, metadata={"PhysicalSizeX": 100.0, "PhysicalSizeY": 100.0})
    else:  # 72 to the inch are those of a printer
        told = {"imagej": True, "metadata": {"unit": "um"}} if writer == "imagej" else {}
        per_unit = (0.01, 0.01) if told else (72, 72)
        tifffile.imwrite(path, image, resolution=per_unit, photometric="minisblack", **told)
    for asked, pitch_mm in (((), 0.1 if writer != "camera" else 1.0), (("--pitch-mm", "0.2"), 0.2)):
        found = answer(call, "evaluate", verb, path, *asked)
        assert found["unit"] == ("cycles/px" if pitch_mm == 1.0 else "LP/mm")
        seen = found["edges"][0]["mtf50"]
        seen = seen["value"] if verb == "mtf" else seen
        assert seen == pytest.approx(MTF50_CPP / pitch_mm, rel=0.01)


def test_the_mean_leaves_out_what_cannot_be_used(call: Call, tmp_path: Path) -> None:
    noise = np.random.default_rng(0).normal(0, 1e-4, (16, 40))
    clipped = np.clip(edge()[:, ::-1] + noise, 0.2, 0.8)
    np.save(tmp_path / "two.npy", np.concatenate([edge() + noise, clipped], axis=1))
    found = json.loads(call("evaluate", "mtf", tmp_path / "two.npy", "--json").stdout)
    assert [one["usable"] for one in found["edges"]] == [True, False]
    own = found["edges"][0]["mtf50"]["value"]
    assert found["mean"]["mtf50"]["value"] == pytest.approx(own, rel=1e-12)


def test_all_frames_of_a_burst_together(call: Call, tmp_path: Path) -> None:
    frames = np.stack([edge(0.0), edge(0.5)])
    burst = Burst.from_arrays(frames, offset_px=[[0.0, 0.0], [0.0, 0.5]], pitch_mm=0.1)
    save_burst(burst, tmp_path / "burst.nc")
    found = answer(call, "evaluate", "mtf", tmp_path / "burst.nc", "--joint")["edges"][0][
        "mtf50_lpmm"
    ]["value"]
    assert found == pytest.approx(10 * MTF50_CPP, rel=0.005)


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--region", "1,2"], 2, "expected a region like"),
        (["--region", "nan,9,0,9"], 2, "expected a region like"),
        (["--region", "0,99,0,9"], 1, "rows of the region within 0 to 16"),
        (["--joint"], 2, "needs a burst file"),
        (["--pitch-mm", "x"], 2, "expected a pitch like"),
    ],
)
def test_wrong_arguments(
    call: Call, tmp_path: Path, options: list[str], code: int, message: str
) -> None:
    np.save(tmp_path / "edge.npy", edge())
    done = call("evaluate", "mtf", tmp_path / "edge.npy", *options)
    assert done.exit_code == code
    assert message in " ".join(done.stderr.split())
