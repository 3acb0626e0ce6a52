"""What the chain is computed with: kernels that were compiled for this processor, or a device's.

`device.py` has the other set, and is loaded only where one is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from lensshift.core.local_means import mean_around
from lensshift.forward.model import ForwardModel
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.learned.network import Network

if TYPE_CHECKING:
    from lensshift.reconstruction.learned.device import DeviceKernels

Array = Any  # of NumPy or of the device


class Compiled:
    """Numba, NumPy and SciPy, one burst after the other."""

    xp: Any = np  # what NumPy and the library of a device share of the array API

    def there(self, values: Array) -> Array:
        """Return an array on the device."""
        return values

    def back(self, values: Array) -> Array:
        """Return an array of the device in NumPy."""
        return values

    def operator(self, model: ForwardModel) -> LinearOperator:
        """Return A of pictures [burst row col] in single precision; the gain of the model is 1."""
        A = model.operator
        return LinearOperator(
            A.in_shape, A.out_shape, lambda x: _each(A.forward, x), lambda y: _each(A.adjoint, y)
        )

    def applied(self, network: Network, seen: Sequence[Array], facts: Array) -> Array:
        """Return the channels [burst row col out] of a network for parts [burst row col ...]."""
        return _each(lambda *parts: network(parts, facts), *seen)

    def mean_around(self, values: Array, size_px: int) -> Array:
        """Return the mean over a window [... row col]; beyond the border there are zeros."""
        return mean_around(values, size_px, zeros=True)


COMPILED = Compiled()
Kernels: TypeAlias = "Compiled | DeviceKernels"


def _each(apply: Callable[..., Array], *batches: Array) -> Array:
    if len(batches[0]) == 1:  # mostly
        return apply(*(batch[0] for batch in batches))[None]
    return np.stack([apply(*ones) for ones in zip(*batches, strict=True)])
