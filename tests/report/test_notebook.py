"""Values show themselves: text of one screen, HTML with a picture, datasets, tables."""

import base64
import copy
import doctest
import io
import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import lensshift
from lensshift.core.optical import MtfCurve
from lensshift.core.types import Burst, Estimate, Reconstruction
from lensshift.evaluation.slanted_edge import EdgeResult
from lensshift.io import save_burst, save_reconstruction

MOST_LINES, MOST_COLUMNS = 40, 110


def some_burst(seed: int = 0) -> Burst:
    rng = np.random.default_rng(seed)
    return Burst.from_arrays(
        rng.random((4, 11, 17)) + 1.0,
        rng.random((4, 11, 17)) + 3.0,
        offset_px=[[0, 0], [0, 0.5], [0.5, 0], [0.5, 0.5]],
        offset_sigma_px=np.full((4, 2), 0.01),
        valid=rng.random((4, 11, 17)) > 0.1,
        modulation_hz=15e6,
        time_s=np.arange(4.0),
        meta={"camera": "x" * 500},
    )


def some_result() -> Reconstruction:
    return lensshift.reconstruct(some_burst(), method="tikhonov", channel="amplitude")


def some_edge() -> EdgeResult:
    row, col = np.mgrid[:31, :44]
    step = 1.0 / (1.0 + np.exp(-(col - 22 - 0.1 * row) / 0.4))
    noisy = 0.1 + 0.8 * step + np.random.default_rng(1).normal(0, 0.004, step.shape)
    return lensshift.measure_edges(noisy, pitch_mm=0.1)[0]


@pytest.fixture(scope="module")
def values() -> list[Burst | Reconstruction | Estimate | EdgeResult | MtfCurve]:
    result, edge = some_result(), some_edge()
    return [some_burst(), result, result["amplitude"], edge, edge.mtf]


def test_text_fits_on_a_screen_and_names_the_type(values) -> None:
    for value in values:
        lines = repr(value).splitlines()
        assert lines[0] == type(value).__name__
        assert len(lines) <= MOST_LINES
        assert max(map(len, lines)) <= MOST_COLUMNS
    text = repr(values[0])
    assert "[4 x 11 x 17] float64, 1 to 2" in text
    assert "modulation_hz" in text
    assert "0x" not in "".join(map(repr, values))  # no address of a function


def test_text_of_what_has_no_numbers() -> None:
    empty = Estimate(np.full((2, 3), np.nan), notes={"a": (1.0,) * 9, "b": [None]})
    assert repr(empty).splitlines()[1].split() == ["image", "[2", "x", "3]", "float64"]
    assert "9 numbers, 1 to 1" in repr(empty)


def test_html_holds_a_picture_that_is_not_empty(values) -> None:
    for value in values:
        page = value._repr_html_()
        code = re.search(r'src="data:image/png;base64,([^"]+)"', page)
        assert code is not None
        assert 'alt="' in page
        with Image.open(io.BytesIO(base64.b64decode(code[1]))) as picture:
            assert np.asarray(picture.convert("L")).std() > 5
        assert len(page) < 300_000
    assert "&lt;" in Estimate(np.ones((3, 4)), notes={"a": "<b>"})._repr_html_()


def test_html_of_what_there_is_little_of() -> None:
    little = [
        Burst.from_arrays(np.ones((1, 1, 1))),
        Burst.from_arrays(np.ones((2, 4, 5, 7), complex), modulation_hz=(15e6, 20e6)),
        Estimate(np.full((40, 3), np.nan)),
        MtfCurve(np.zeros(1), np.ones(1)),
        Reconstruction(None, Estimate(np.ones((6, 8))), lensshift.Grid((6, 8), (1, 1)), 2, "x"),
    ]
    assert all("<img" in value._repr_html_() for value in little)
    nothing = [
        Reconstruction(None, None, lensshift.Grid((6, 8), (1, 1)), 2, "x"),
        lensshift.PointCloud(np.zeros((0, 3)), np.zeros(0, int), np.zeros(0, int)),
    ]
    assert all("<details open>" in value._repr_html_() for value in nothing)


def test_html_does_not_start_what_takes_long() -> None:
    def never() -> np.ndarray:
        raise AssertionError

    assert Estimate(np.eye(3), uncertainty=never)._repr_html_()


def test_values_still_copy_and_pickle(values) -> None:
    for value in values:
        for again in (pickle.loads(pickle.dumps(value)), copy.deepcopy(value)):
            assert repr(again).splitlines()[0] == repr(value).splitlines()[0]


def test_datasets_are_those_of_the_files(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    burst, result = some_burst(3), some_result()
    save_burst(burst, tmp_path / "burst.nc")
    save_reconstruction(result, tmp_path / "result.nc")
    with xarray.open_dataset(tmp_path / "burst.nc", engine="h5netcdf") as there:
        xarray.testing.assert_identical(there.load(), burst.to_xarray())
    found = result.to_xarray()
    np.testing.assert_array_equal(found["amplitude"], result["amplitude"].image)
    np.testing.assert_array_equal(found["amplitude_std"], result["amplitude"].std)


def test_tables() -> None:
    pytest.importorskip("pandas")
    burst, edge = some_burst(), some_edge()
    frames = burst.to_pandas()
    assert list(frames.index) == [0, 1, 2, 3]
    np.testing.assert_array_equal(frames["offset_col_px"], burst.offset_px[:, 1])
    np.testing.assert_allclose(frames["valid_share"], burst.valid.mean(axis=(1, 2)))
    numbers = edge.to_pandas()
    assert numbers.loc["mtf50_lpmm", "value"] == edge.mtf50_lpmm.value
    assert numbers.loc["mtf50_lpmm", "low"] < numbers.loc["mtf50_lpmm", "high"]
    curve = edge.mtf.to_pandas()
    np.testing.assert_array_equal(curve["modulation"], edge.mtf.modulation)


def test_help_begins_with_an_example_that_holds() -> None:
    text = (lensshift.__doc__ or "").splitlines()
    assert text[2].startswith(">>> ")
    found = doctest.testmod(lensshift)
    assert found.attempted >= 5
    assert found.failed == 0


def test_a_channel_by_name() -> None:
    result = some_result()
    assert result["amplitude"] is result.amplitude
    with pytest.raises(KeyError, match="which has amplitude; got 'distance'"):
        result["distance"]


WITHOUT = """
import sys
for name in ("xarray", "pandas"):
    sys.modules[name] = None
import numpy as np, lensshift
burst = lensshift.Burst.from_arrays(np.ones((1, 3, 5)))
for ask in (burst.to_xarray, burst.to_pandas):
    try:
        ask()
    except ImportError as error:
        print(error)
repr(burst)
print("matplotlib" in sys.modules)
"""


def test_what_is_not_installed_is_named_and_text_needs_no_figure() -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT], capture_output=True, text=True, check=True
    )
    first, second, drawn = done.stdout.splitlines()
    assert drawn == "False"
    assert "pip install 'lensshift[notebook]'" in first
    assert "pip install 'lensshift[notebook]'" in second


STRICT = """
import lensshift
import numpy as np

burst = lensshift.Burst.from_arrays(np.ones((4, 5, 7)), offset_px=np.zeros((4, 2)))
result = lensshift.reconstruct(burst, scale=2)
image = result["amplitude"].image
error = result["amplitude"].std
reveal_type(result["amplitude"])
"""


@pytest.mark.slow
def test_strict_types_need_no_assertion(tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    (tmp_path / "user.py").write_text(STRICT, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--python-version", "3.11", "user.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "Estimate" in done.stdout


def test_a_pitch_that_nobody_told_is_not_shown() -> None:
    frames = np.arange(48.0).reshape(2, 4, 6)
    untold = Burst.from_arrays(frames)
    result = Reconstruction(Estimate(np.ones((8, 12))), None, untold.grid.refine(2), 2, "x", {})
    for value, shape in ((untold, "4, 6"), (result, "8, 12")):
        assert f"shape {shape}, pitch not told" in repr(value)
        assert "pitch_mm" not in repr(value) + value._repr_html_()
    assert "pitch_mm 0.1, 0.1" in repr(Burst.from_arrays(frames, pitch_mm=0.1))
