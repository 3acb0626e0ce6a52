"""The unrolled solver in PyTorch: exact data steps alternate with a small convolutional prior.

    v_0     = argmin |y - A v|^2_W + c |grad v|^2
    x_t, s_t = prior_t(v_{t-1}, residuals, noise of each HR pixel)
    v_t     = argmin |y - A v|^2_W + k_t |(v - x_t) / s_t|^2

The prior sees pictures on the HR grid, folded 2 x 2 into channels. Its layers have no bias and the
first one does not see the level, so that a u + b is reconstructed from a y + b: contrast and level
mean nothing. `lensshift.reconstruction.learned` runs the same steps in NumPy.
"""

from __future__ import annotations

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

STAGES, CHANNELS, MEMORY, PICTURES, FACTS = 4, 40, 8, 6, 4
START_STEPS, DATA_STEPS, LAST_STEPS = 8, 4, 8
START_STIFFNESS = 0.02


class Model:
    """A and its adjoint for bursts of one geometry: y[b k u v] = rows x cols^T."""

    def __init__(self, rows: Tensor, cols: Tensor) -> None:
        self.rows, self.cols = rows, cols
        k, u, h = rows.shape
        v, w = cols.shape[1:]
        self._flat_rows = rows.reshape(k * u, h)
        self._shape = (k, u, h, v, w)

    def forward(self, x: Tensor) -> Tensor:
        """Return the frames [burst frame row col] of pictures [burst row col]."""
        k, u, h, v, w = self._shape
        # One large product for the rows of all bursts and frames, then one a frame for the columns.
        taken = (self._flat_rows @ x.transpose(0, 1).reshape(h, -1)).reshape(k, u * len(x), w)
        return (taken @ self.cols.transpose(1, 2)).reshape(k, u, len(x), v).permute(2, 0, 1, 3)

    def adjoint(self, y: Tensor) -> Tensor:
        """Return the pictures that frames spread to."""
        k, u, h, v, w = self._shape
        spread = y.permute(1, 2, 0, 3).reshape(k, u * len(y), v) @ self.cols
        found = self._flat_rows.T @ spread.reshape(k * u, len(y) * w)
        return found.reshape(h, len(y), w).transpose(0, 1)


def solve(apply, b: Tensor, x: Tensor, diagonal: Tensor, lowest: Tensor, steps: int) -> Tensor:
    """Return x after some Chebyshev steps on apply(x) = b.

    The eigenvalues of apply over `diagonal` are at most 1; those below `lowest` are left to x. No
    inner product over the picture: what one region holds cannot touch another.
    """
    middle, half = (1 + lowest) / 2, (1 - lowest) / 2
    rho = half / middle
    r = b - apply(x)
    d = r / diagonal / middle
    for step in range(steps):
        x = x + d
        if step + 1 == steps:
            break
        r = r - apply(d)
        following = 1 / (2 * middle / half - rho)
        d = following * rho * d + 2 * following / half * (r / diagonal)
        rho = following
    return x


def stiffness(x: Tensor) -> Tensor:
    """Return the gradient of half the squared differences between neighbours."""
    out = torch.zeros_like(x)
    for axis in (1, 2):
        d = x.diff(dim=axis)
        pad = (0, 0, 1, 1) if axis == 1 else (1, 1)
        out = out - functional.pad(d, pad).diff(dim=axis)
    return out


class Prior(nn.Module):
    """One stage: pictures in, a better picture, its uncertainty and a memory out."""

    def __init__(self, channels: int, last: bool) -> None:
        super().__init__()
        outputs = 12 if last else 8 + MEMORY
        sizes = [4 * PICTURES + MEMORY, channels, channels, channels, outputs]
        self.layers = nn.ModuleList(
            nn.Conv2d(a, b, 3, padding=1, bias=False) for a, b in pairwise(sizes)
        )
        for layer in self.layers[:-1]:
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
        nn.init.normal_(self.layers[-1].weight, std=1e-3)
        self.facts = nn.Linear(FACTS, 2 * channels)
        nn.init.zeros_(self.facts.weight)
        nn.init.zeros_(self.facts.bias)

    def forward(self, pictures: Tensor, memory: Tensor, facts: Tensor) -> Tensor:
        """Return channels [burst out row/2 col/2] of pictures [burst picture row col]."""
        first = self.layers[0].weight
        level = first[:, :4].mean((1, 2, 3), keepdim=True)  # the estimate's own level is not seen
        weight = torch.cat([first[:, :4] - level, first[:, 4:]], 1)
        x = torch.cat([functional.pixel_unshuffle(pictures, 2), memory], 1)
        x = x.to(memory_format=torch.channels_last)
        x = functional.conv2d(functional.pad(x, (1, 1, 1, 1), mode="replicate"), weight)
        a, b = (1 + self.facts(facts)).chunk(2)
        x = functional.relu(x) * a[:, None, None]
        # Half precision is enough behind the layer that takes the level off.
        with half_precision(x, self.training):
            x = functional.relu(self.layers[1](x)) * b[:, None, None].to(x.dtype)
            x = functional.relu(self.layers[2](x))
            return self.layers[3](x).float()


class Solver(nn.Module):
    """The whole chain; see the module."""

    def __init__(self, channels: int = CHANNELS, stages: int = STAGES) -> None:
        super().__init__()
        self.priors = nn.ModuleList(Prior(channels, t + 1 == stages) for t in range(stages))
        self.trust = nn.Parameter(torch.zeros(stages))  # log k_t
        self.forgive = nn.Parameter(torch.full((stages,), 1.0))  # log of the Huber limit in sigma
        self.floor = nn.Parameter(torch.tensor([0.0] * stages + [-2.0]))  # log, least std / noise
        lowest = torch.tensor([0.05] + [0.1] * (stages - 1) + [0.05])
        self.lowest = nn.Parameter(torch.logit(lowest))  # least eigenvalue of the data steps
        self.doubt = nn.Parameter(torch.full((stages,), -2.0))  # log, share of the misfit forgiven

    def forward(self, y, valid, sigma, rows, cols, facts, scale):
        """Return the estimates of all stages [burst row col] and the std of the last."""
        model = Model(rows, cols)
        unit = (sigma * valid).sum((1, 2, 3), keepdim=True) / valid.sum((1, 2, 3), keepdim=True)
        weight = valid * (unit / sigma) ** 2
        unit = unit[:, 0]
        density = model.adjoint(weight)
        floor = 0.02 * rows.shape[0] / scale**2
        x = model.adjoint(weight * y) / (density + floor * 1e-3)
        v = solve(
            lambda p: model.adjoint(weight * model.forward(p)) + START_STIFFNESS * stiffness(p),
            model.adjoint(weight * y), x, density + 8 * START_STIFFNESS,
            torch.sigmoid(self.lowest[0]), START_STEPS,
        )  # fmt: skip
        n = unit / torch.sqrt(density + floor)
        rows_cols = ((v.shape[1] + 1) // 2, (v.shape[2] + 1) // 2)
        memory = v.new_zeros(len(v), MEMORY, *rows_cols)
        found, std = [v], v
        robust, past = weight, x
        for t, prior in enumerate(self.priors):
            r = y - model.forward(v)
            spread = torch.exp(self.forgive[t]) * sigma + torch.exp(self.doubt[t]) * (
                local_rms(r, valid)
            )
            robust = weight * torch.clamp(spread / (r.abs() + 1e-12), max=1.0)
            mass = model.adjoint(robust) + floor
            pictures = torch.stack(
                [v, v - past, 8 * model.adjoint(robust * r) / mass,
                 2 * torch.sqrt(model.adjoint(weight * r * r) / (density + floor) + 1e-14),
                 n, unit / torch.sqrt(mass)], 1,
            )  # fmt: skip
            out = prior(fold_pad(pictures), memory, facts)
            memory = out[:, 8:] if t + 1 < len(self.priors) else None
            shape = v.shape[1:]
            x = v + unfold(out[:, :4], shape)
            s = torch.abs(unfold(out[:, 4:8], shape)) + torch.exp(self.floor[t]) * n
            if memory is None:
                std = torch.abs(unfold(out[:, 8:], shape)) + torch.exp(self.floor[-1]) * n
            k = torch.exp(self.trust[t]) * (unit / s) ** 2
            k = torch.clamp(k, 1e-3, 1e4)
            past = v
            steps = DATA_STEPS if memory is not None else LAST_STEPS
            v = solve(
                lambda p, w=robust, k=k: model.adjoint(w * model.forward(p)) + k * p,
                model.adjoint(robust * y) + k * x, x, mass - floor + k,
                torch.sigmoid(self.lowest[t + 1]), steps,
            )  # fmt: skip
            found.append(v)
        return found, std


def half_precision(x: Tensor, wanted: bool) -> torch.autocast:
    """Return a context in which convolutions are in bfloat16."""
    return torch.autocast(x.device.type, torch.bfloat16, enabled=wanted, cache_enabled=False)


def facts_of(blur_hr_px: float, scale: int, frames: int) -> Tensor:
    """Return what modulates the prior: blur, scale and samples per HR pixel, all about 0 .. 1."""
    samples = frames / scale**2
    values = [blur_hr_px - 0.6, scale / 2 - 1, math.log(samples) / 2, 1 / (1 + samples)]
    return torch.tensor(values, dtype=torch.float32)


def local_rms(r: Tensor, valid: Tensor) -> Tensor:
    """Return the rms of the residual over 3 x 3 pixels of each frame."""
    b, k, u, v = r.shape
    both = torch.stack([r * r * valid, valid], 2).reshape(b * k, 2, u, v)
    mean = functional.avg_pool2d(both, 3, 1, 1)
    return torch.sqrt(mean[:, :1] / (mean[:, 1:] + 1e-6) + 1e-14).reshape(b, k, u, v)


def fold_pad(pictures: Tensor) -> Tensor:
    """Return pictures of even size, the last row and column repeated where needed."""
    h, w = pictures.shape[2:]
    return (
        functional.pad(pictures, (0, w % 2, 0, h % 2), mode="replicate")
        if h % 2 or w % 2
        else pictures
    )


def unfold(folded: Tensor, shape: torch.Size) -> Tensor:
    """Return the picture [burst row col] of four channels."""
    return functional.pixel_shuffle(folded, 2)[:, 0, : shape[0], : shape[1]]
