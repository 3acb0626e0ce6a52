"""The unrolled solver for phasors in PyTorch: both components at once, and their covariance.

The same chain as in `network.py`, in units of the noise. The prior sees the picture without its
local mean over its local deviation, and beside its own amplitude; its correction is in units of
the smaller of the two: flat surfaces stay as they are, dark ones beside bright ones count as much.
The last word has the prior: beside a bright surface a small error of the shifts is larger than
all that a dark one sends, and a data step would believe it.
A burst is turned by the phase of its mean phasor before, and back afterwards: an equal delay of
all light moves all distances alike. `lensshift.reconstruction.learned` does the same in NumPy.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from network import (
    DATA_STEPS,
    FACTS,
    MEMORY,
    START_STEPS,
    START_STIFFNESS,
    Model,
    fold_pad,
    half_precision,
    local_rms,
    solve,
    stiffness,
)
from torch import Tensor, nn
from torch.nn import functional

STAGES, CHANNELS = 4, 40
PICTURES = 12
AROUND = 9  # HR pixels along the window of the local mean and deviation
LIMIT = 12.0  # of the logarithm of a std over the noise


class PhasorPrior(nn.Module):
    """One stage: pictures in; corrections of both components, log std, memory out."""

    def __init__(self, channels: int, last: bool) -> None:
        super().__init__()
        outputs = 24 if last else 12 + MEMORY
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
        x = torch.cat([functional.pixel_unshuffle(pictures, 2), memory], 1)
        x = functional.pad(x, (1, 1, 1, 1), mode="replicate")
        x = x.to(memory_format=torch.channels_last)
        a, b = (1 + self.facts(facts)).chunk(2)
        with half_precision(x, self.training):
            x = functional.conv2d(x, self.layers[0].weight)
            x = functional.relu(x) * a[:, None, None].to(x.dtype)
            x = functional.relu(self.layers[1](x)) * b[:, None, None].to(x.dtype)
            x = functional.relu(self.layers[2](x))
            return self.layers[3](x).float()


class PhasorSolver(nn.Module):
    """The whole chain; see the module."""

    def __init__(self, channels: int = CHANNELS, stages: int = STAGES) -> None:
        super().__init__()
        self.priors = nn.ModuleList(PhasorPrior(channels, t + 1 == stages) for t in range(stages))
        self.trust = nn.Parameter(torch.zeros(stages))  # log k_t
        self.forgive = nn.Parameter(torch.full((stages,), 1.0))  # log of the Huber limit in sigma
        lowest = torch.tensor([0.05] + [0.1] * (stages - 1) + [0.05])
        self.lowest = nn.Parameter(torch.logit(lowest))  # least eigenvalue of the data steps
        self.doubt = nn.Parameter(torch.full((stages,), -2.0))  # log, share of the misfit forgiven

    def forward(self, y, valid, sigma, rows, cols, facts, scale):
        """Return the estimates of all stages [burst 2 row col], and of the last one log std along
        and across the phasor and their correlation [burst 3 row col], in units of y.
        """
        geometry = Model(rows, cols)
        unit = (sigma * valid).sum((1, 2, 3), keepdim=True) / valid.sum((1, 2, 3), keepdim=True)
        relative = sigma / unit
        weight = valid / relative**2
        middle = (y * valid[:, None]).sum((2, 3, 4))
        middle = middle / (middle.norm(dim=1, keepdim=True) + 1e-12)
        unit = unit[:, None, 0]
        y = turned(y / unit[..., None], middle, -1)
        w = weight[:, None]

        def forward(p):
            return geometry.forward(p.flatten(0, 1)).unflatten(0, (-1, p.shape[1]))

        def adjoint(p):
            return geometry.adjoint(p.flatten(0, 1)).unflatten(0, (-1, p.shape[1]))

        density = adjoint(w)
        floor = 0.02 * rows.shape[0] / scale**2
        b = adjoint(w * y)
        past = b / (density + floor * 1e-3)
        v = solve(
            lambda p: adjoint(w * forward(p)) + START_STIFFNESS * stiff(p),
            b, past, density + 8 * START_STIFFNESS, torch.sigmoid(self.lowest[0]), START_STEPS,
        )  # fmt: skip
        n = 1 / torch.sqrt(density + floor)
        shape = v.shape[2:]
        memory = v.new_zeros(len(v), MEMORY, (shape[0] + 1) // 2, (shape[1] + 1) // 2)
        found, spread = [turned(v, middle, 1) * unit], None
        for t, prior in enumerate(self.priors):
            last = t + 1 == len(self.priors)
            r = y - forward(v)
            size = torch.sqrt((r * r).mean(1) + 1e-12)  # of a component
            limit = torch.exp(self.forgive[t]) * relative + torch.exp(self.doubt[t]) * local_rms(
                size, valid
            )
            robust = (weight * torch.clamp(limit / size, max=1.0))[:, None]
            mass = adjoint(robust) + floor
            chi = torch.sqrt(adjoint(w * size[:, None] ** 2) / (density + floor) + 1e-12)
            level = local_mean(v)
            a = torch.sqrt((v * v).sum(1, keepdim=True) + n * n).detach()
            apart = ((v - level) ** 2).sum(1, keepdim=True)
            d = torch.sqrt(local_mean(apart) + n * n).detach()
            pictures = torch.cat(
                [(v - level) / d, (v - past) / d, 8 * adjoint(robust * r) / mass / d, v / a,
                 torch.log(a / n) / 3, torch.log(d / n) / 3, torch.log(chi), n * torch.sqrt(mass)],
                1,
            )  # fmt: skip
            out = prior(fold_pad(pictures), memory, facts)
            memory = out[:, 12:]
            x = v + torch.minimum(a, d) * unfolded(out[:, :8], shape)
            s = n * torch.exp(torch.clamp(unfolded(out[:, 8:12], shape), -LIMIT, LIMIT))
            k = torch.clamp(torch.exp(self.trust[t]) / (s * s), 1e-3, 1e4)
            if last:
                v = x
            else:
                past = v
                v = solve(
                    lambda p, robust=robust, k=k: adjoint(robust * forward(p)) + k * p,
                    adjoint(robust * y) + k * x, x, mass - floor + k,
                    torch.sigmoid(self.lowest[t + 1]), DATA_STEPS,
                )  # fmt: skip
            found.append(turned(v, middle, 1) * unit)
            if last:
                log_std = torch.clamp(unfolded(out[:, 12:20], shape), -LIMIT, LIMIT)
                log_std = log_std + torch.log(n * unit)
                both = torch.tanh(unfolded(out[:, 20:24], shape)) * 0.95
                spread = torch.cat([log_std, both], 1)
        return found, spread


def turned(z: Tensor, unit: Tensor, way: int) -> Tensor:
    """Return phasors [burst 2 ...] turned by unit phasors [burst 2], or back (-1)."""
    c, s = (part.reshape(-1, *[1] * (z.dim() - 2)) for part in unit.T)
    re, im = z[:, 0], z[:, 1]
    return torch.stack([re * c - way * im * s, im * c + way * re * s], 1)


def stiff(p: Tensor) -> Tensor:
    """Return `stiffness` of both components."""
    return stiffness(p.flatten(0, 1)).unflatten(0, (-1, p.shape[1]))


def local_mean(a: Tensor) -> Tensor:
    """Return the mean [burst picture row col] over a window; at the border over what is there."""
    return functional.avg_pool2d(a, AROUND, 1, AROUND // 2, count_include_pad=False)


def unfolded(folded: Tensor, shape: torch.Size) -> Tensor:
    """Return pictures [burst picture row col] of four channels each."""
    return functional.pixel_shuffle(folded, 2)[..., : shape[0], : shape[1]]
