"""What the learned priors see of a picture, and what their channels mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Floats
from lensshift.reconstruction.learned.chain import Picture, Single, State
from lensshift.reconstruction.learned.kernels import Kernels
from lensshift.reconstruction.learned.network import Network, fold, unfold

# Of the form that the weights were trained in (training/phasor_network.py); not to be tuned.
AROUND_HR_PX = 9
LOG_LIMIT = 12.0
CORRELATION_LIMIT = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class BrightnessPrior:
    """For real pictures: what is multiplied or added to all frames comes back in the picture.

    Parameters
    ----------
    stages : the networks
    numbers : learned for the data steps: lowest eigenvalue, trust, forgive, doubt
    last_steps : data steps after the last stage
    """

    stages: tuple[Network, ...]
    numbers: Mapping[str, Floats]
    last_steps: int = 8

    def improve(
        self, t: int, state: State, facts: NDArray[np.float32], memory: Single | None
    ) -> tuple[Picture, Single, Single]:
        """Return x, its standard deviation, and all channels of stage t."""
        seen = [state.v, state.v - state.past, 8 * state.gradient, 2 * state.misfit,
                state.noise, state.trusted]  # fmt: skip
        channels = _applied(self.stages[t], seen, state, memory, 8, facts)
        x = state.v + _drawn(channels[..., :4], state)
        return x, self._std(channels[..., 4:8], state, t), channels

    def spread(self, channels: Single, state: State) -> Single:
        """Return [burst 1 row col], the standard deviation of the error."""
        return self._std(channels[..., 8:12], state, -1)[:, None]

    def _std(self, channels: Single, state: State, t: int) -> Single:
        least = float(np.exp(self.numbers["floor"][t]))
        std: Single = state.on.xp.abs(_drawn(channels, state)) + least * state.noise
        return std


@dataclass(frozen=True, slots=True, eq=False)
class PhasorPrior:
    """For phasors: all is relative to the amplitude of a pixel or to how it differs around.

    It has the last word. Beside a bright surface a small error of the shifts is larger than all
    that a dark one sends, and a data step would believe it.
    """

    stages: tuple[Network, ...]
    numbers: Mapping[str, Floats]
    last_steps: int = 0

    def improve(
        self, t: int, state: State, facts: NDArray[np.float32], memory: Single | None
    ) -> tuple[Picture, Single, Single]:
        """Return x, the standard deviation of a component, and all channels of stage t."""
        v, noise, xp = state.v, state.noise, state.on.xp
        a: Single = xp.sqrt(v.real**2 + v.imag**2 + noise * noise)
        apart = v - (_local_mean(state.on, v.real) + 1j * _local_mean(state.on, v.imag))
        square = _local_mean(state.on, apart.real**2 + apart.imag**2)
        d: Single = xp.sqrt(square + noise * noise)
        seen = [
            *_parts(apart / d), *_parts((v - state.past) / d), *_parts(8 * state.gradient / d),
            *_parts(v / a), xp.log(a / noise) / 3, xp.log(d / noise) / 3,
            xp.log(xp.clip(state.misfit, 1e-6, None)), noise / state.trusted,
        ]  # fmt: skip
        channels = _applied(self.stages[t], seen, state, memory, 12, facts)
        step = _drawn(channels[..., :4], state) + 1j * _drawn(channels[..., 4:8], state)
        s = noise * xp.exp(_log(channels[..., 8:12], state))
        return v + xp.minimum(a, d) * step, s, channels

    def spread(self, channels: Single, state: State) -> Single:
        """Return [burst 3 row col]: std along and across the phasor, and their correlation."""
        xp = state.on.xp
        along, across = (state.noise * xp.exp(_log(channels[..., n : n + 4], state))
                         for n in (12, 16))  # fmt: skip
        both = CORRELATION_LIMIT * xp.tanh(_drawn(channels[..., 20:24], state))
        spread: Single = xp.stack([along, across, both], 1)
        return spread


LearnedPrior = BrightnessPrior | PhasorPrior


def _applied(
    network: Network,
    seen: list[Single],
    state: State,
    before: Single | None,
    first: int,
    facts: NDArray[np.float32],
) -> Single:
    """Return the channels of a stage; those of the one before are remembered from `first` on."""
    on = state.on
    folded = fold(on.xp, [state.turn.there(on.xp, picture) for picture in seen])
    if before is None:
        remembered = network.layers[0].shape[0] // 9 - 4 * len(seen)
        memory = on.there(np.zeros((*folded.shape[:3], remembered), np.float32))
    else:
        memory = before[..., first:]
    channels: Single = on.applied(network, [folded, memory], facts)
    return channels


def _drawn(channels: Single, state: State) -> Single:
    """Return the picture [burst row col] that four channels are."""
    xp = state.on.xp
    shape = state.v.shape[1:]
    return state.turn.back(xp, unfold(channels, shape[::-1] if state.turn.transposed else shape))


def _parts(z: Picture) -> tuple[Single, Single]:
    return z.real, z.imag


def _log(channels: Single, state: State) -> Single:
    log: Single = state.on.xp.clip(_drawn(channels, state), -LOG_LIMIT, LOG_LIMIT)
    return log


def _local_mean(on: Kernels, a: Single) -> Single:
    """Return the mean over a window, of what there is of it at the border."""
    share = on.mean_around(on.xp.ones_like(a), AROUND_HR_PX)
    mean: Single = on.mean_around(a, AROUND_HR_PX) / share
    return mean
