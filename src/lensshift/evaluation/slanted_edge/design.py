"""The linear part of the edge at one geometry: level columns, splines and their products."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensshift.evaluation.slanted_edge.edge_model import (
    Matrix,
    SplineBasis,
    Vector,
    edge_response_slopes,
)
from lensshift.evaluation.slanted_edge.kernels import (
    MARGIN,
    difference_products,
    pull_back,
    spline_differences,
)
from lensshift.evaluation.slanted_edge.samples import EdgeSamples, level_columns


@dataclass(frozen=True, slots=True, eq=False)
class Products:
    """Cross products over all pixels; x are the level columns, z the splines, y the values.

    Parameters
    ----------
    xx, xy, zz, zx, zy : [p p], [p], [j j], [j p], [j]
    """

    xx: Matrix
    xy: Vector
    zz: Matrix
    zx: Matrix
    zy: Vector


class EdgeDesign:
    """What the whitened pixels are made of: D = W [X Z], levels X and integrated splines Z.

    Parameters
    ----------
    samples : pixels of the region
    basis : splines of the LSF
    geometry : of the edge
    sigma_px, aperture_px : of the base model
    """

    def __init__(
        self,
        samples: EdgeSamples,
        basis: SplineBasis,
        geometry: Vector,
        sigma_px: float,
        aperture_px: float,
    ) -> None:
        self._samples, self._basis, self._geometry = samples, basis, geometry
        normal_px = samples.normal_px(geometry)
        self._slopes = edge_response_slopes(normal_px, float(geometry[0]), sigma_px, aperture_px)
        columns = samples.whitener @ level_columns(self._slopes[0], samples.tilt_columns)
        self._columns = np.column_stack([columns, samples.values])
        place = (normal_px - basis.knot_px[0]) / basis.step_px
        self._place = np.clip(place, -2.0, basis.knot_px.size + 1.0)
        first, parts = np.empty(place.size, dtype=np.intp), np.empty((place.size, 5))
        spline_differences(self._place, first, parts)
        whitener = samples.whitener
        self._rows = (first, parts, whitener.indptr, whitener.indices, whitener.data)

    def products(self) -> Products:
        """Return the cross products, those of the far pixels included."""
        far, step, levels = self._samples.far, self._basis.step_px, self._columns.shape[1] - 1
        knots = self._basis.knot_px.size + 2 * MARGIN
        squares, crossed = np.zeros((knots, knots)), np.zeros((knots, levels + 1))
        difference_products(*self._rows, self._columns, squares, crossed)
        squares += np.triu(squares, 1).T
        zz = step**2 * _summed_behind(_summed_behind(squares).T)
        zx = step * _summed_behind(crossed)
        xx = self._columns[:, :levels].T @ self._columns
        return Products(
            xx=xx[:, :levels] + far.level_products,
            xy=xx[:, levels] + far.level_values,
            zz=zz + step**2 * far.right_square,
            zx=zx[:, :levels] + step * far.right_levels,
            zy=zx[:, levels] + step * far.right_values,
        )

    def gradient(self, factors: Vector, covariance: Matrix) -> Vector:
        """Return how the misfit and the log determinant change, halved and times the variance.

            sum over pixels of  dD . (D C - (y - D b) b^T)

        Parameters
        ----------
        factors : [p + j] b, of levels and splines
        covariance : [p + j, p + j] C, of the factors

        Returns
        -------
        [g + 1]
            By the geometry and the log of the base model's width.
        """
        samples, levels = self._samples, self._columns.shape[1] - 1
        whole = np.vstack([covariance + np.outer(factors, factors), -factors])
        # Spline j is the sum of all differences from j on: what splines count adds up.
        by_part = self._basis.step_px * np.cumsum(whole[levels:-1], axis=0)
        by_part = np.pad(by_part, ((MARGIN, 0), (0, 0)))
        by_part = np.pad(by_part, ((0, MARGIN), (0, 0)), mode="edge")
        by_column = np.vstack([whole[:levels], whole[-1]])
        beyond = ((0, 0), (MARGIN, MARGIN))
        by_place = np.zeros(self._place.size)
        by_level = np.zeros((self._place.size, levels))
        pull_back(
            self._place,
            *self._rows,
            self._columns,
            np.pad(by_part[:, levels:], beyond),
            np.pad(by_column[:, levels:], beyond),
            np.vstack([by_part[:, :levels], by_column[:, :levels]]),
            by_place,
            by_level,
        )
        by_response = by_level[:, 1]
        if samples.tilt_columns is not None:
            by_response = by_response + np.sum(samples.tilt_columns * by_level[:, 4:], axis=1)
        _, by_distance, by_angle, by_log_sigma = self._slopes
        gradient = (by_place + by_response * by_distance) @ samples.distance_slopes(self._geometry)
        gradient[0] += by_response @ by_angle
        return np.append(gradient, by_response @ by_log_sigma)


def _summed_behind(sums: Matrix) -> Matrix:
    """Return [j k]: sums over all differences from each knot on, of [padded k]."""
    whole: Matrix = np.cumsum(sums[::-1], axis=0)[::-1]
    return whole[MARGIN:-MARGIN]
