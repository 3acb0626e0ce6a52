"""How the likelihood of shifts goes up and bends: its gradient, Fisher information, curvature."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array, Floats, Shifts
from lensshift.registration.curvature import Curvature
from lensshift.registration.spectrum import Learned, Solved, Spectrum, Steering

# For differences of the score.
_STEP_PX = 0.02


class Score(NamedTuple):
    """What the frames say of the parameters of each frame (row, col, and gain if that is free)."""

    learned: Learned  # of scene and noise beside
    gradient: Floats  # [set parameter] of the log likelihood
    information: Floats  # [set parameter parameter], that of Fisher

    def of(self, number: int, free: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Return gradient and information of one set by some of the parameters."""
        return self.gradient[number, free], self.information[number][np.ix_(free, free)]


@dataclass(slots=True)
class State:
    """Where a search stands; several sets of frames lie at the same shifts."""

    offset_px: Shifts
    log_gain: Floats
    spectrum: Spectrum

    @property
    def steering(self) -> Steering:
        """What the frames see of each frequency and its aliases."""
        return self.spectrum.frequencies.steering(self.offset_px, np.exp(self.log_gain))

    def score(self, spectra: Array, kinds: int, *, whole: bool) -> Score:
        """Return what one inversion of all covariances tells of shifts, scene and noise.

        With W = S^-1 and E = D W, of frames k, l and kinds a, b

            information = 2 Re sum over f of  E_a[k l] E_b[l k] + (E_a D_b^H)[k l] W[l k]

        Parameters
        ----------
        spectra : [frequency frame]
        kinds : 2 or, with the gain, 3 parameters of each frame
        whole : whether level and exponent of the spectrum are fitted as well, or the noise alone
        """
        count, at = len(self.offset_px), self.spectrum.frequencies
        steering, turned = self.steering, self._turned(kinds)
        gradient = np.zeros((at.sets, count, kinds))
        information = np.zeros((at.sets, count, kinds, count, kinds))
        pairs = list(combinations_with_replacement(range(kinds), 2))

        def ask(one: Solved) -> None:
            slopes = _slopes(turned, one.part, steering)
            whitened, weight = slopes @ one.inverse, 2.0 * at.of_set[:, one.part]
            own = np.diagonal(whitened, axis1=2, axis2=3)
            gradient[...] += _gradient(weight, slopes, one.seen, own)
            back = np.swapaxes(one.inverse, 1, 2)
            for a, b in pairs:
                shared = whitened[a] * np.swapaxes(whitened[b], 1, 2)
                shared += (whitened[a] @ np.conj(np.swapaxes(slopes[b], 1, 2))) * back
                information[:, :, a, :, b] += np.tensordot(weight, np.real(shared), 1)

        learned = self.spectrum.learned(spectra, steering, whole=whole, ask=ask)
        for a, b in pairs:
            information[:, :, b, :, a] = np.swapaxes(information[:, :, a, :, b], 1, 2)
        square = information.reshape(at.sets, kinds * count, kinds * count)
        return Score(
            learned, gradient.reshape(at.sets, -1), 0.5 * (square + np.swapaxes(square, 1, 2))
        )

    def curvatures(
        self, spectra: Array, moved: Callable[[Shifts], Array], information: Floats, reference: int
    ) -> list[Curvature]:
        """Return the curvature of each set by a common shift of all frames but the reference.

        Parameters
        ----------
        spectra : [frequency frame] under tapers that stay
        moved : spectra under tapers at other shifts [frame 2]
        information : [set parameter parameter] that of Fisher
        """
        count = len(self.offset_px)
        kinds = information.shape[1] // count
        others = np.tile(np.eye(kinds, 2), (count, 1, 1))
        others[reference] = 0.0
        together = others.reshape(-1, 2)
        bent = np.empty((2, len(information), 2, 2))
        for axis in (0, 1):
            scores = []
            for sign in (-1.0, 1.0):
                there = State(
                    self.offset_px + sign * _STEP_PX * others[:, :2, axis],
                    self.log_gain, self.spectrum,
                )  # fmt: skip
                scores.append(there._gradients((spectra, moved(there.offset_px)), kinds) @ together)
            bent[..., axis] = (scores[1] - scores[0]) / (-2.0 * _STEP_PX)
        fisher = together.T @ information @ together
        return [Curvature(*one) for one in zip(fisher, *bent, strict=True)]

    def _gradients(self, spectra: tuple[Array, ...], kinds: int) -> Array:
        """Return the gradient [taper set parameter] alone, for several tapers."""
        at, steering, turned = self.spectrum.frequencies, self.steering, self._turned(kinds)
        found = np.zeros((len(spectra), at.sets, len(self.offset_px), kinds))
        backs = [steering.back * one for one in spectra]
        for part, inverse, _, _ in self.spectrum.solved(spectra[0], steering):
            slopes = _slopes(turned, part, steering)
            weight = 2.0 * at.of_set[:, part]
            own = np.einsum("afkl,flk->afk", slopes, inverse)
            for number, y in enumerate(backs):
                seen = (inverse @ y[part][..., None])[..., 0]
                found[number] += _gradient(weight, slopes, seen, own)
        return found.reshape(len(spectra), at.sets, -1)

    def _turned(self, kinds: int) -> Array:
        """Return the power of each alias times what a parameter multiplies it with [kind f alias].

        dS / dp = e_k v^T + conj(v) e_k^T touches one row and one column of S only: v is row k of
        D = sum P q b b^H,  q = -2 pi i (f + m) for a shift, 1 for the log gain; here without
        -2 pi i.
        """
        at = self.spectrum.frequencies
        return self.spectrum.power * np.stack([at.down, at.right, np.ones_like(at.down)][:kinds])


def _gradient(weight: Floats, slopes: Array, seen: Array, own: Array) -> Floats:
    slope = np.conj(seen) * (slopes @ seen[..., None])[..., 0]
    return np.asarray(np.einsum("sf,afk->ska", weight, np.real(slope - own)))


def _slopes(turned: Array, part: slice, steering: Steering) -> Array:
    """Return D [kind frequency frame frame] of a part of the frequencies."""
    slopes = steering.summed(turned[:, part])
    slopes[:2] *= -2j * np.pi
    return slopes
