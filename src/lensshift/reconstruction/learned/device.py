"""The kernels of the chain in what NumPy and PyTorch share of the array API, for a device.

    y[i] = sum_n w[i, n] x[index[i, n]]

The operator and its adjoint are such gathers, with tables of the taps and of their transpose: sums
in a fixed order, so that a burst gives the same picture twice. Convolutions are matrix products,
which keep single precision (those of cuDNN round to ten bits unless told otherwise).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Floats
from lensshift.forward.model import ForwardModel, Taps
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.learned.network import Network

Array = Any  # of NumPy or of the device


@dataclass(frozen=True, slots=True)
class DeviceKernels:
    """Kernels in the array API.

    Parameters
    ----------
    xp : NumPy or PyTorch
    device : as the library calls it
    """

    xp: Any
    device: str

    def there(self, values: Array) -> Array:
        """Return an array on the device."""
        return self.xp.asarray(values, device=self.device)

    def back(self, values: Array) -> Array:
        """Return an array of the device in NumPy."""
        return values if isinstance(values, np.ndarray) else np.asarray(values.cpu())

    def operator(self, model: ForwardModel) -> LinearOperator:
        """Return A of pictures [burst row col] in single precision; the gain of the model is 1."""
        if model.rows.start.ndim == 3:
            forward, adjoint = _of_field(self, model)
        else:
            forward, adjoint = _of_shifts(self, model)
        return LinearOperator(
            model.hr_shape,
            (model.frames, *model.lr_shape),
            lambda x: self._by_parts(forward, x),
            lambda y: self._by_parts(adjoint, y),
        )

    def _by_parts(self, apply: Callable[[Array], Array], values: Array) -> Array:
        """Apply a real linear map to the real and to the imaginary part of values."""
        if values.dtype != self.xp.complex64:
            return apply(values)
        parts = apply(self.xp.concat([values.real, values.imag], 0))
        return parts[: len(values)] + 1j * parts[len(values) :]

    def applied(self, network: Network, seen: Sequence[Array], facts: NDArray[np.float32]) -> Array:
        """Return the channels [burst row col out] of a network for parts [burst row col ...]."""
        x = self.xp.concat([part.reshape(*part.shape[:3], -1) for part in seen], 3)
        layers = _layers(self, network, tuple(facts.tolist()))
        x = self.xp.concat([x[:, :1], x, x[:, -1:]], 1)  # the border is repeated once
        x = self._convolved(self.xp.concat([x[:, :, :1], x, x[:, :, -1:]], 2), layers[0])
        for weight in layers[1:]:
            bursts, rows, cols, channels = x.shape
            wide = self._zeros(bursts, rows + 2, cols + 2, channels)
            wide[:, 1:-1, 1:-1] = self.xp.clip(x, 0, None)
            x = self._convolved(wide, weight)
        return x

    def _convolved(self, x: Array, weight: Array) -> Array:
        """Return x [burst row col in] without its margin of one, times weight [3, 3 in, out]."""
        rows, cols = x.shape[1] - 2, x.shape[2] - 2
        beside = self.xp.concat([x[:, :, n : n + cols] for n in range(3)], 3)
        out = beside[:, :rows] @ weight[0]
        for n in (1, 2):
            out += beside[:, n : n + rows] @ weight[n]
        return out

    def mean_around(self, values: Array, size_px: int) -> Array:
        """Return the mean over a window [... row col]; beyond the border there are zeros."""
        along = self._summed(self._summed(values, size_px).mT, size_px).mT
        return along / size_px**2

    def _summed(self, values: Array, size_px: int) -> Array:
        """Return the sum over neighbours along the last axis."""
        half, count = size_px // 2, values.shape[-1]
        wide = self._zeros(*values.shape[:-1], count + 2 * half)
        wide[..., half : half + count] = values
        total = wide[..., :count]
        for n in range(1, size_px):
            total = total + wide[..., n : n + count]
        return total

    def _zeros(self, *shape: int) -> Array:
        return self.xp.zeros(shape, dtype=self.xp.float32, device=self.device)


def device_kernels(name: str) -> DeviceKernels:
    """Return the kernels of a device: "cpu", "cuda" or "cuda:1" (PyTorch), or "numpy".

    Raises
    ------
    ValueError
        If the name is none, or there is no such device.
    ImportError
        If PyTorch is not installed.
    """
    if name == "numpy":
        return DeviceKernels(np, "cpu")
    if not isinstance(name, str) or not re.fullmatch(r"cpu|cuda(:\d+)?", name):
        raise ValueError(
            f"device: expected 'cpu', 'cuda', 'cuda:1' or 'numpy', or none at all, got {name!r}"
        )
    try:
        torch = import_module("torch")
    except ImportError as error:
        raise ImportError(
            f"device {name!r} needs PyTorch: python -m pip install 'lensshift[torch]'"
        ) from error
    number = int(name.partition(":")[2] or 0)
    if name != "cpu" and number >= torch.cuda.device_count():
        raise ValueError(
            f"device: PyTorch finds {torch.cuda.device_count()} CUDA devices here, so there is no "
            f"{name!r}; 'cpu' works everywhere, and no device at all is fastest without CUDA"
        )
    return DeviceKernels(torch, name)


# Four stages of two kinds, for a few kinds of bursts.
@lru_cache(maxsize=32)
def _layers(on: DeviceKernels, network: Network, facts: tuple[float, ...]) -> list[Array]:
    """Return the weights [3, 3 in, out] of each layer, with the gain of the layer before."""
    gains = np.split(1 + np.array(facts, np.float32) @ network.facts + network.gain_offset, 2)
    layers = []
    for number, weight in enumerate(network.layers):
        taps = weight.reshape(9, -1, weight.shape[1])
        if number in (1, 2):
            taps = taps * gains[number - 1][:, None]
        layers.append(on.there(np.array(taps.reshape(3, -1, weight.shape[1]), np.float32)))
    return layers


def _of_shifts(
    on: DeviceKernels, model: ForwardModel
) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """Return A and its adjoint where all pixels of a frame have one shift: rows, then columns."""
    k, (u, v), (h, w) = model.frames, model.lr_shape, model.hr_shape
    down, up = _both_ways(on, *_separate(model.rows, 0), h)
    right, left = _both_ways(on, *_separate(model.cols, w), k * w)

    def forward(x: Array) -> Array:
        lines = _gathered(on.xp, x, down).reshape(-1, k, u, w).mT.reshape(-1, k * w, u)
        return _gathered(on.xp, lines, right).reshape(-1, k, v, u).mT

    def adjoint(y: Array) -> Array:
        lines = _gathered(on.xp, y.mT.reshape(-1, k * v, u), left)
        return _gathered(on.xp, lines.reshape(-1, k, w, u).mT.reshape(-1, k * u, w), up)

    return forward, adjoint


def _of_field(
    on: DeviceKernels, model: ForwardModel
) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """Return A and its adjoint where each pixel has a shift of its own."""
    (h, w), rows, cols = model.hr_shape, model.rows, model.cols
    index = _places(rows)[..., :, None] * w + _places(cols)[..., None, :]
    weight = rows.weight[..., :, None] * cols.weight[..., None, :]
    count = rows.start.size
    take, spread = _both_ways(on, index.reshape(count, -1), weight.reshape(count, -1), h * w)
    steps, back = [take], [spread]
    if model.leaning is not None:
        lean, upright = _both_ways(on, *model.leaning, h * w)
        steps, back = [lean, take], [spread, upright]

    def through(values: Array, tables: list[Table]) -> Array:
        for table in tables:
            values = _gathered(on.xp, values, table)
        return values

    def forward(x: Array) -> Array:
        return through(x.reshape(-1, h * w, 1), steps).reshape(-1, *rows.start.shape)

    def adjoint(y: Array) -> Array:
        return through(y.reshape(-1, count, 1), back).reshape(-1, h, w)

    return forward, adjoint


def _places(taps: Taps) -> NDArray[np.int64]:
    return taps.start[..., None] + np.arange(taps.weight.shape[-1])


def _separate(taps: Taps, apart: int) -> tuple[NDArray[np.int64], Floats]:
    """Return index and weight [frame pixel, T], the lines of each frame `apart` from the last."""
    count = taps.weight.shape[-1]
    frame = np.arange(len(taps.start))[:, None, None]
    return (_places(taps) + apart * frame).reshape(-1, count), taps.weight.reshape(-1, count)


Table = tuple[Array, Array]  # index and weight [out, n]


def _both_ways(
    on: DeviceKernels, index: NDArray[np.int64], weight: Floats, size: int
) -> tuple[Table, Table]:
    """Return the table of a gather from `size` places, and that of its adjoint."""
    from scipy.sparse import csr_array

    count, taps = index.shape
    ends = np.arange(0, count * taps + 1, taps)
    spread = csr_array((weight.ravel(), index.ravel(), ends), (count, size)).T.tocsr()
    spread.eliminate_zeros()
    many = np.diff(spread.indptr)
    held = np.arange(max(int(many.max(initial=0)), 1)) < many[:, None]
    back_index, back_weight = np.zeros(held.shape, np.int64), np.zeros(held.shape)
    back_index[held], back_weight[held] = spread.indices, spread.data
    take, back = ((on.there(np.array(i)), on.there(np.array(w, np.float32)))
                  for i, w in ((index, weight), (back_index, back_weight)))  # fmt: skip
    return take, back


def _gathered(xp: Any, x: Array, table: Table) -> Array:
    """Return [burst out line] of lines [burst in line]."""
    index, weight = table
    return xp.matmul(weight[:, None, :], x[:, index])[:, :, 0]
