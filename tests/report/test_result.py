"""The picture of a result shows every channel, on one scale with what it is compared to."""

from typing import Any

import numpy as np
import pytest
from drawn import assert_well_drawn, axes_titled

from lensshift.core.grid import Grid
from lensshift.core.point_cloud import PointCloud
from lensshift.core.types import Estimate, Reconstruction, Status
from lensshift.report.result import cloud_figure, drawn_pixels, result_figure


def _result(shape: tuple[int, int], *, distance: bool = True) -> Reconstruction:
    rng = np.random.default_rng(0)
    image, std = rng.uniform(1, 2, shape), rng.uniform(0, 0.1, shape)
    misfit = rng.chisquare(4, shape) / 4
    channels = [
        Estimate(image + add, uncertainty=std, status=Status.COMPLETE, misfit=misfit)
        for add in (0.0, 3.0)
    ]
    grid = Grid(shape, (0.1, 0.1))
    second = channels[1] if distance else None
    return Reconstruction(channels[0], second, grid, 2, "auto", {})


def _drawn(figure, start):
    return axes_titled(figure, start).get_images()[0]


@pytest.mark.parametrize("shape", [(16, 64), (40, 30), (3, 2), (1, 50)])
@pytest.mark.parametrize("distance", [True, False])
def test_all_there_is_to_know_is_drawn(shape: tuple[int, int], distance: bool) -> None:
    result = _result(shape, distance=distance)
    figure = result_figure(result, {"amplitude": np.full(shape, 7.0)}, title="a result")
    for name in result.channels:
        assert _drawn(figure, f"standard deviation of {name}").get_clim()[0] == 0.0
    shown, compared = _drawn(figure, "amplitude"), _drawn(figure, "amplitude, one frame")
    assert compared.get_clim() == shown.get_clim()
    assert shown.get_clim()[1] < 7.0
    np.testing.assert_array_equal(shown.get_array(), result.amplitude.image)
    misfit = _drawn(figure, "misfit")
    assert misfit.get_clim() == (1.0, 10.0)
    assert sum(bool(axes.get_images()) for axes in figure.axes) == (6 if distance else 4)
    if min(shape) > 2:
        assert_well_drawn(figure)


@pytest.mark.parametrize("shape", [(90, 12), (60, 40), (40, 60), (12, 300)])
@pytest.mark.parametrize("distance", [True, False])
def test_images_of_any_shape_fit_a_page_and_their_titles_too(
    shape: tuple[int, int], distance: bool
) -> None:
    figure = result_figure(_result(shape, distance=distance), {"amplitude": np.ones(shape)})
    assert figure.get_size_inches()[1] < 20.0  # tall ones were 70 inches high
    figure.draw_without_rendering()
    titled = [axes for axes in figure.axes if axes.get_title("left")]
    assert len(titled) == (6 if distance else 4)
    for axes in titled:
        assert axes._left_title.get_window_extent().x1 < figure.bbox.x1


@pytest.mark.parametrize("shape", [(40, 30), (16, 64)])
def test_each_kind_of_picture_has_its_column_where_one_is_missing(shape: tuple[int, int]) -> None:
    """Phasors of several frequencies have no bicubic of their distance."""
    figure = result_figure(_result(shape), {"amplitude": np.ones(shape)})
    along = 0 if shape[0] > shape[1] else 1
    for kind in ("", "standard deviation of "):
        first, second = (
            axes_titled(figure, f"{kind}{name}").get_position().get_points()[0, along]
            for name in ("amplitude", "distance")
        )
        assert first == pytest.approx(second)


def test_pictures_of_nothing_and_of_phasors_are_drawn() -> None:
    image = np.full((5, 9), np.nan)
    grid = Grid((5, 9), (0.1, 0.1))
    for values in (image, np.ones((5, 9)) * (3 + 4j)):
        one = Estimate(values, status=Status.DIRECT)
        drawn = _drawn(result_figure(Reconstruction(one, None, grid, 1, "x", {})), "amplitude")
        np.testing.assert_array_equal(np.ma.getdata(drawn.get_array()), np.abs(values))


def test_no_label_beside_tall_points_is_cut_off() -> None:
    place_m = np.random.default_rng(0).uniform(-3, 3, (400, 3)) * (1, 1, 0.5)  # tall
    figure = cloud_figure(PointCloud(place_m, *np.divmod(np.arange(400), 20)))
    drawn_pixels(figure)
    axes: Any = figure.axes[0]
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        box = axis.label.get_window_extent()
        assert min(box.x0, box.y0) >= 0
        assert box.x1 <= figure.bbox.x1
        assert box.y1 <= figure.bbox.y1
