"""What is left of the information on a shift when the taper follows the content."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Floats

Square = Floats

# Where less of the information is left, the taper tells of the shift, not the scene: random cards
# and textures leave 0.67 and more along their weakest direction, single edges 0.28 and less.
LEAST_SHARE = 0.4
# As good as nothing is known: so many standard errors.
_BLIND = 1e6
# Of the Fisher information, so that roots exist.
_FLOOR = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Curvature:
    """Curvature [2 2] of the log likelihood by a common shift of all frames but the reference.

    The taper is put where the shift is taken to be. It moves along an edge without a change of the
    picture, so whatever shift is taken for true seems to be: the Fisher information does not know.
    With J the information that the frames bear out and H the curvature with the taper in tow, the
    score vanishes at a shift of covariance H^-1 J H^-T, which is J^-1 where H = J.

    Source: Huber (1967) for the covariance of such estimates.
    """

    fisher: Square  # the Fisher information
    fixed: Square  # J, the taper stays
    moved: Square  # H, it follows

    @property
    def least_share(self) -> float:
        """Share of the information that is left along the direction that loses most."""
        least = _FLOOR * float(np.linalg.eigvalsh(self.fisher)[0])
        white = _root(self.fixed, -0.5, max(least, 1e-300))
        return float(np.linalg.svd(white @ self.moved @ white, compute_uv=False)[-1])

    def step(self, information: Square, kinds: int) -> Square:
        """Return what takes a score to a step, H^-1; 0 where nothing is known.

        Parameters
        ----------
        information : [parameter parameter] of the frames but the reference, `kinds` of each, the
            first two its shift
        """
        white, inner = self._inverse(0.0)
        block = _of_each(inner @ white @ self.fisher, information, kinds)
        return np.asarray(block @ inverse(information))

    def covariance(self, information: Square, kinds: int) -> Square:
        """Return the covariance of the parameters, very large where nothing is known."""
        block = self._inverse(_BLIND)[1] @ _root(self.fisher, 0.5, 0.0)
        move = _of_each(block, information, kinds)
        return np.asarray(move @ inverse(information) @ move.T)

    def _inverse(self, blind: float) -> tuple[Square, Square]:
        """Return J^-1/2, and H^-1 J^1/2 with `blind` where little of the information is left."""
        least = _FLOOR * float(np.linalg.eigvalsh(self.fisher)[0])
        white = _root(self.fixed, -0.5, max(least, 1e-300))
        left, share, right = np.linalg.svd(white @ self.moved @ white)
        back = np.where(share > LEAST_SHARE, 1.0 / np.clip(share, LEAST_SHARE, 1.0), blind)
        return white, np.asarray(white @ (right.T * back) @ left.T)


def inverse(information: Square) -> Square:
    """Return the inverse on the parameters of which anything is known."""
    return np.asarray(np.linalg.pinv(information, rcond=1e-9, hermitian=True))


def newton(
    score: Floats, information: Square, curvature: Curvature | None, kinds: int
) -> tuple[Floats, Square]:
    """Return the step of the parameters that a score asks for, and their covariance."""
    if curvature is None:
        spread = inverse(information)
        return spread @ score, spread
    return curvature.step(information, kinds) @ score, curvature.covariance(information, kinds)


def _of_each(block: Square, information: Square, kinds: int) -> Square:
    """Return the matrix that treats the shift of each frame alike and leaves its gain."""
    whole = np.eye(kinds)
    whole[:2, :2] = block
    return np.kron(np.eye(len(information) // kinds), whole).astype(np.float64)


def _root(matrix: Square, power: float, least: float) -> Square:
    value, vector = np.linalg.eigh(0.5 * (matrix + matrix.T))
    root: Square = (vector * np.maximum(value, least) ** power) @ vector.T
    return root
