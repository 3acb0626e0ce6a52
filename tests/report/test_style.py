"""Figures leave the user's settings alone, need no pyplot, and are written whole or not at all."""

import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from lensshift import report
from lensshift.core.errors import DataError
from lensshift.report.images import draw_image, draw_map
from lensshift.report.save import save_figure
from lensshift.report.style import COLOURS, new_figure, styled


def simple_figure() -> Figure:
    with styled():
        figure = new_figure(3.0, 2.0)
        axes = figure.subplots()
        axes.plot([0.0, 1.0], [0.0, 1.0], label="rise")
        axes.set_xlabel("time (s)")
    return figure


def test_settings_of_the_user_neither_change_nor_show(tmp_path: Path) -> None:
    plain, other = tmp_path / "plain.png", tmp_path / "other.png"
    save_figure(simple_figure(), plain)
    loud = {"lines.linewidth": 9.0, "axes.facecolor": "yellow", "font.size": 20.0}
    loud |= {"lines.marker": "o", "xtick.direction": "in", "figure.facecolor": "red"}
    with mpl.rc_context(loud):
        before = dict(mpl.rcParams)
        save_figure(simple_figure(), other)
        assert dict(mpl.rcParams) == before
    assert other.read_bytes() == plain.read_bytes()
    with pytest.raises(KeyError), styled():
        raise KeyError
    assert mpl.rcParams["lines.linewidth"] == mpl.rcParamsDefault["lines.linewidth"]


def test_importing_and_drawing_need_no_pyplot() -> None:
    code = (
        "import sys, lensshift, lensshift.report.save\n"
        "assert not any(name.startswith('matplotlib') for name in sys.modules)\n"
        "from lensshift.report import images, style\n"
        "with style.styled():\n"
        "    images.draw_image(style.new_figure(1, 1).subplots(), [[1, 2]], '')\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
    for module in Path(report.__file__).parent.glob("*.py"):
        assert "pyplot" not in module.read_text(encoding="utf-8")


# What eyes without green, or without red receptors see of linear RGB: Machado, Oliveira and
# Fernandes, IEEE Transactions on Visualization and Computer Graphics 15 (2009) 1291.
SEEN_BY = {
    "all": np.eye(3),
    "no green": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "no red": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
}


@pytest.mark.parametrize("eyes", SEEN_BY)
def test_the_first_colours_stay_apart_for_all_eyes(eyes: str) -> None:
    rgb = np.array([to_rgb(colour) for colour in COLOURS[:4]])
    seen = np.clip(rgb**2.2 @ SEEN_BY[eyes].T, 0.0, 1.0) ** (1 / 2.2)
    apart = np.linalg.norm(seen[:, None] - seen[None, :], axis=-1) + 9.0 * np.eye(len(rgb))
    assert apart.min() > 0.2


@pytest.mark.parametrize(
    ("ending", "start"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".PDF", b"%PDF")]
)
def test_a_figure_is_written_by_its_ending_and_twice_the_same(
    tmp_path: Path, ending: str, start: bytes
) -> None:
    first, second = tmp_path / f"first{ending}", tmp_path / f"second{ending}"
    for path in (first, second):
        save_figure(simple_figure(), path)
    assert first.read_bytes().startswith(start)
    assert first.read_bytes() == second.read_bytes()
    assert sorted(tmp_path.iterdir()) == [first, second]


def test_a_name_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    figure = simple_figure()
    for name in ("curve.jpg", "curve", "png"):
        with pytest.raises(ValueError, match=r"\.png, \.svg, \.pdf"):
            save_figure(figure, tmp_path / name)
    with pytest.raises(DataError, match="no folder"):
        save_figure(figure, tmp_path / "missing" / "curve.png")
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(DataError, match="folder"):
        save_figure(figure, tmp_path / "folder.png")


def test_a_figure_that_cannot_be_drawn_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "curve.png"
    save_figure(simple_figure(), path)
    old = path.read_bytes()
    broken = simple_figure()
    broken.axes[0].set_title("$\\nosuchcommand$")
    with pytest.raises(ValueError, match="nosuchcommand"):
        save_figure(broken, path)
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


def test_pixels_of_an_image_lie_where_their_numbers_say() -> None:
    image = np.zeros((3, 7))
    image[2, 5] = 1.0
    axes = new_figure(7.0, 3.0).subplots()
    shown = draw_image(axes, image, "spot", corner_px=(10, 20))
    left, right, bottom, top = shown.get_extent()
    assert (left, right, top, bottom) == (19.5, 26.5, 9.5, 12.5)
    assert axes.get_xlim() == (19.5, 26.5)
    assert axes.get_ylim() == (12.5, 9.5)  # rows downwards
    np.testing.assert_array_equal(shown.get_array(), image)


def test_grey_is_not_set_by_a_few_bright_pixels() -> None:
    image = np.linspace(0.0, 1.0, 2000).reshape(40, 50)
    image[3, 4] = 1e6
    shown = draw_image(new_figure(3.0, 3.0).subplots(), image, "")
    assert shown.get_clim()[1] < 1.1


def test_pixels_without_value_are_seen_as_such() -> None:
    image = np.zeros((9, 9))
    image[:5] = 1.0
    image[3, 3] = np.nan
    axes = new_figure(2.0, 2.0).subplots()
    shown = draw_image(axes, image, "")
    assert shown.get_array()[3, 3] is np.ma.masked
    assert "no value" in axes.get_xlabel()
    nothing = draw_image(new_figure(2.0, 2.0).subplots(), np.full((4, 5), np.nan), "nothing")
    assert nothing.get_clim() == (0.0, 1.0)
    with pytest.raises(ValueError, match=r"\(3,\)"):
        draw_image(axes, np.zeros(3), "")


@pytest.mark.parametrize(
    ("values", "extend"),
    [([-1, 1], "neither"), ([-3, 1], "min"), ([0, 9], "max"), ([-9, 9], "both")],
)
def test_a_signed_map_is_symmetric_and_tells_what_lies_beyond(
    values: list[float], extend: str
) -> None:
    figure = new_figure(3.0, 2.0)
    shown = draw_map(figure.subplots(), [values], "error", "mm", largest=2.0)
    assert shown.get_clim() == (-2.0, 2.0)
    middle = shown.to_rgba(np.zeros(1))[0, :3]
    assert middle.min() > 0.95  # white at 0
    assert shown.colorbar is not None
    assert shown.colorbar.extend == extend
    assert shown.colorbar.ax.get_ylabel() == "mm"
