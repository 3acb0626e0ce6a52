"""The network of one stage: four small convolutions without bias on pictures folded 2 x 2.

That of brightness does not see the level of the picture, so its prior commutes with a u + b.
Weights come from `training/`; this module only applies them.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array, Floats
from lensshift.reconstruction.learned.convolution import convolved, transformed, with_margin

Single = NDArray[np.floating[Any]]  # float32, which NumPy's types lose on the way

# Of the files, so that a damaged installation says so; written by training/export.py.
WEIGHTS_SHA256 = {
    "square": "61bce4ef6e4047da37cd0a219be7dc39f9d352bd28f63dc25649cc33ad37e228",
    "brightness": "a1262ea9848a1c643d625eb2b2666c7add3a3f6e527f5442a77203b546f27789",
    "phasor": "cefa804fee062bd98f15d6137c9b504578781aeab2c71067798f57bde1272576",
    "response": "33bb502676f08590f767779be4eaf06d5fa07aa4bdf79fa526c6f693cd3cd7ba",
}
# Those whose first channels are a picture with its level.
OF_PICTURES = ("square", "brightness")


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """The weights of one stage.

    Parameters
    ----------
    layers : [9 in, out] of each convolution, taps of 3 x 3 in row order, then channel
    facts : [fact, gain] and gain_offset [gain], what modulates the first two layers
    points : the layers as `convolved` takes them
    """

    layers: tuple[Single, ...]
    facts: Single
    gain_offset: Single
    points: tuple[Single, ...]

    def __call__(self, seen: Sequence[Single], facts: Single) -> Single:
        """Return [row col out] for parts [row col ...] of what is seen, and facts of the burst."""
        x = with_margin(seen)
        for number, weight in enumerate(_modulated(self, facts.tobytes())):
            x = convolved(x, weight, seen[0].shape[:2], last=number + 1 == len(self.points))
        return x


@lru_cache(maxsize=16)  # a stream asks for the same again and again
def _modulated(network: Network, facts: bytes) -> tuple[Single, ...]:
    """Return the layers as `convolved` takes them, each with the gain of the one before."""
    told = np.frombuffer(facts, np.float32)
    gains = np.split(1 + told @ network.facts + network.gain_offset, 2)
    first, second, third, *others = network.points
    return first, second * gains[0][:, None], third * gains[1][:, None], *others


def fold(xp: Any, pictures: list[Any]) -> Any:
    """Return pictures [burst row col] as channels [burst row/2 col/2 n 2 2].

    The last row or column is repeated at an odd end.
    """
    x = xp.stack(pictures, 1)
    for axis in (2, 3):
        if x.shape[axis] % 2:
            x = xp.concat([x, x[:, :, -1:] if axis == 2 else x[..., -1:]], axis)
    bursts, count, rows, cols = x.shape
    blocks = x.reshape(bursts, count, rows // 2, 2, cols // 2, 2)
    return xp.moveaxis(blocks, (2, 4), (1, 2))


def unfold(channels: Any, shape: tuple[int, ...]) -> Any:
    """Return the picture [burst row col] of four channels [burst row/2 col/2 4]."""
    bursts, rows, cols = channels.shape[:3]
    blocks = channels.reshape(bursts, rows, cols, 2, 2).swapaxes(2, 3)
    return blocks.reshape(bursts, 2 * rows, 2 * cols)[:, : shape[0], : shape[1]]


@lru_cache
def learned_weights(name: str) -> tuple[tuple[Network, ...], dict[str, Floats]]:
    """Return what was learned and came with the package: networks, numbers of the data steps.

    Parameters
    ----------
    name : "brightness", "square", "phasor" or "response"

    Raises
    ------
    OSError
        If the file is not the one that belongs to this version.
    """
    file = resources.files(__package__) / f"{name}.npz"
    content = file.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    if digest != WEIGHTS_SHA256[name]:
        raise OSError(f"{file.name} is damaged (sha256 {digest[:12]}...); install lensshift again")
    with np.load(io.BytesIO(content)) as stored:
        arrays = dict(stored)
    if name in OF_PICTURES:
        _forget_level(arrays)
    return _networks_of(arrays)


def _forget_level(stored: dict[str, Array]) -> None:
    """Take off the first layers what half precision left of their answer to an even picture."""
    for name in [one for one in stored if one.startswith("layer_") and one.endswith("_0")]:
        taps = stored[name].astype(np.float64)
        own = taps.reshape(9, -1, taps.shape[1])[:, :4]
        own -= own.mean(axis=(0, 1))
        stored[name] = taps


def _networks_of(stored: dict[str, Array]) -> tuple[tuple[Network, ...], dict[str, Floats]]:
    stages: list[Network] = []
    while f"layer_{len(stages)}_0" in stored:
        t = len(stages)
        layers = tuple(
            np.ascontiguousarray(stored[f"layer_{t}_{n}"], np.float32)
            for n in range(sum(name.startswith(f"layer_{t}_") for name in stored))
        )
        facts, offset = (stored[f"{name}_{t}"].astype(np.float32) for name in ("facts", "gain"))
        stages.append(Network(layers, facts, offset, tuple(map(transformed, layers))))
    kinds = ("layer_", "facts_", "gain_")
    numbers = {name: values.astype(np.float64)
               for name, values in stored.items() if not name.startswith(kinds)}  # fmt: skip
    return tuple(stages), numbers
