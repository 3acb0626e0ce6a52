"""Train what reads the width of the pixel response from frames (`learned/response.py`).

python training/worlds.py --count 6000 --seed 901 --out worlds.npy
python training/response.py worlds.npy --count 144000 --minutes 26 --out response.pt
python training/export.py response.pt src/lensshift/reconstruction/learned/response.npz
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from bursts import Bench, Geometry, draw_errors, drawn_scenes, read_noise, spoilt, square_px
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from torch import Tensor, nn
from torch.nn import functional

from lensshift.forward.blur import GaussianBlur
from lensshift.forward.model import forward_model
from lensshift.reconstruction.learned.noise import LEAST_FRAMES
from lensshift.reconstruction.learned.response import ASSUMED_PX, SCALE, VOTE, pictures_of

Generator = np.random.Generator
SIDE, TOGETHER, BATCH, HELD_OUT = 28, 8, 48, 6000
CHANNELS, PICTURES, FACTS = 32, 5, 4
SIGNED = 2  # of the pictures: they change their sign with the scene
WIDTHS_PX = torch.arange(0.08, 0.48, 0.03)
LEARNING_RATE = 2e-3
# Share of the bursts whose noise is read from them: it takes longer than all else.
READ, READ_TONED = 0.15, 0.3
# Of the cameras: not linear. Clipped edges look sharper than any pixel sees them.
TONED = 0.4
LEAST_SIGMA = 0.29 / 255  # of rounding, where clipping leaves nothing else


def draw_bench(rng: Generator) -> tuple[Bench, float]:
    """Return a camera, pixel and lens of any width, and the width of both in LR pixels."""
    counts, shares = [1, 2, 3, 4, 5, 6, 9, 12, 16], [3, 4, 5, 50, 5, 4, 14, 5, 10]
    count = int(rng.choice(counts, p=np.array(shares) / 100))
    side = round(count**0.5)
    if side * side == count and rng.random() < 0.75:
        offset = square_px(rng, side, 1.0 / SCALE, 0.4)
    else:
        offset = rng.uniform(-1, 1, (count, 2)) * (0.5 if rng.random() < 0.7 else 1.5)
    samples = int(rng.choice([10, 12]))
    g = Geometry(SCALE, (SIDE, SIDE), np.clip(offset, -1.6, 1.6), samples)
    fill = 1.0 if rng.random() < 0.3 else float(rng.uniform(0.3, 1))
    lens = 0.0 if rng.random() < 0.4 else float(rng.uniform(0.03, 0.35))
    none = torch.zeros(1)
    return Bench(g, 0.0, none, none, (none, none), fill, lens, False), math.hypot(
        fill / math.sqrt(12), lens
    )


@lru_cache(maxsize=1)
def _pool(worlds: Path) -> np.ndarray:
    torch.set_num_threads(1)
    return np.load(worlds, mmap_mode="r")


def draw(worlds: Path, seed: int, step: int) -> tuple[NDArray[np.float16], float, int]:
    """Return what the network is shown [burst picture row col] of one camera, width and frames."""
    rng = np.random.default_rng((seed, step))
    bench, width_px = draw_bench(rng)
    g = bench.geometry
    scenes = drawn_scenes(rng, _pool(worlds), g, TOGETHER)
    frames = bench.frames(scenes, draw_errors(rng, g, TOGETHER)).numpy()
    frames, valid, sigma, _ = spoilt(rng, frames)
    is_toned = rng.random() < TONED
    if is_toned:
        for k in range(TOGETHER):
            frames[k], gain = toned(rng, frames[k])
            sigma[k] = np.maximum(sigma[k] * gain, LEAST_SIGMA)
    if rng.random() < (READ_TONED if is_toned else READ) and len(g.offset_px) >= LEAST_FRAMES:
        for k in range(TOGETHER):
            sigma[k] = read_noise(g.offset_px, frames[k], valid[k], WIDTHS_PX.mean().item())
    model = forward_model(g.shape, SCALE, g.offset_px, blur=GaussianBlur(ASSUMED_PX))
    seen = pictures_of(model, frames, np.where(valid > 0, sigma, np.inf))
    return np.stack(seen, 1).astype(np.float16), width_px, len(g.offset_px)


def toned(rng: Generator, y: NDArray[np.float32]) -> tuple[NDArray[np.float32], float]:
    """Return frames as cameras for people give them, and the contrast over what it was.

    Clipped at both ends, through a tone curve, sharpened: each of them in about half of the bursts.
    """
    before = float(np.std(y))
    low, high = np.quantile(y, [0.0, 1.0])
    if rng.random() < 0.5:  # before the others, as in the sensor
        low, high = np.quantile(y, [rng.uniform(0, 0.12), 1 - rng.uniform(0, 0.12)])
    z = np.clip((y - low) / max(high - low, 1e-6), 0, 1)
    if rng.random() < 0.5:
        z = z ** float(np.exp(rng.uniform(np.log(0.45), np.log(1.6))))
    if rng.random() < 0.4:
        soft = gaussian_filter(z, (0, *2 * [rng.uniform(0.5, 1.5)]))
        z = z + rng.uniform(0.1, 0.8) * (z - soft)
        z = np.clip(z, 0, 1) if rng.random() < 0.5 else z
    levels = 255.0 if rng.random() < 0.7 else 4095.0
    z = np.round(z * levels) / levels
    return z.astype(np.float32), float(np.std(z)) / max(before, 1e-6)


class Stage(nn.Module):
    """Four convolutions without bias, as the package applies them."""

    def __init__(self) -> None:
        super().__init__()
        sizes = [4 * PICTURES, CHANNELS, CHANNELS, CHANNELS, len(WIDTHS_PX)]
        self.layers = nn.ModuleList(
            nn.Conv2d(a, b, 3, padding=int(n > 0), bias=False)
            for n, (a, b) in enumerate(pairwise(sizes))
        )
        for layer in self.layers[:-1]:
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
        nn.init.normal_(self.layers[-1].weight, std=1e-2)
        self.facts = nn.Linear(FACTS, 2 * CHANNELS)
        nn.init.zeros_(self.facts.weight)
        nn.init.zeros_(self.facts.bias)

    def forward(self, pictures: Tensor, frames: Tensor) -> Tensor:
        """Return channels [burst width row/2 col/2]."""
        samples, none = frames / SCALE**2, torch.zeros_like(frames)
        told = torch.stack([none, none, torch.log(samples) / 2, 1 / (1 + samples)], 1)
        a, b = (1 + self.facts(told))[..., None, None].chunk(2, 1)
        x = functional.pad(functional.pixel_unshuffle(pictures, 2), (1, 1, 1, 1), mode="replicate")
        x = functional.relu(self.layers[0](x)) * a
        x = functional.relu(self.layers[1](x)) * b
        return self.layers[3](functional.relu(self.layers[2](x)))


class Reader(nn.Module):
    """log p(w | y): the prior, and the votes of all places."""

    def __init__(self) -> None:
        super().__init__()
        self.priors = nn.ModuleList([Stage()])
        self.prior = nn.Parameter(torch.zeros(len(WIDTHS_PX)))
        self.register_buffer("widths", WIDTHS_PX)

    def forward(self, pictures: Tensor, frames: Tensor) -> Tensor:
        """Return [burst width] of pictures [burst picture row col]."""
        votes = VOTE * self.priors[0](pictures, frames)[..., 1:-1, 1:-1].sum((2, 3))
        return torch.log_softmax(self.prior + votes, 1)


def loss_of(log: Tensor, width_px: Tensor) -> Tensor:
    """Return the mean of -log p at the true width, between two of the table."""
    at = ((width_px - WIDTHS_PX[0]) / (WIDTHS_PX[1] - WIDTHS_PX[0])).clamp(0, log.shape[1] - 1.001)
    k, burst = at.long(), torch.arange(len(log))
    return -torch.lerp(log[burst, k], log[burst, k + 1], at - k).mean()


def drawn(given: argparse.Namespace) -> tuple[np.ndarray, Tensor]:
    """Return what the network is shown of all bursts, and [burst 2] width and number of frames."""
    file = given.out.with_suffix(".npy")
    shape = (given.count, PICTURES, SCALE * SIDE, SCALE * SIDE)
    shown = np.lib.format.open_memmap(file, "w+", np.float16, shape)
    told = np.zeros((given.count, 2), np.float32)
    one = partial(draw, given.worlds, given.seed)
    with ProcessPoolExecutor(given.threads) as workers:
        found = workers.map(one, range(given.count // TOGETHER), chunksize=8)
        for first, (pictures, *facts) in zip(range(0, given.count, TOGETHER), found, strict=True):
            shown[first : first + TOGETHER], told[first : first + TOGETHER] = pictures, facts
    return shown, torch.tensor(told)


def taken(rng: Generator, shown: np.ndarray, told: Tensor) -> tuple[Tensor, Tensor]:
    """Return a batch, mirrored and transposed, bright and dark exchanged, at random.

    Half of the batches are parts of the frames, so that their size means nothing.
    """
    which = np.sort(rng.integers(0, len(told) - HELD_OUT, BATCH))
    pictures, size = shown[which], shown.shape[-1]
    pictures[:, :SIGNED] *= rng.choice([-1, 1], (BATCH, 1, 1, 1)).astype(np.float16)
    for axes in ((2,), (3,)):
        pictures = np.flip(pictures, axes) if rng.random() < 0.5 else pictures
    pictures = pictures.swapaxes(2, 3) if rng.random() < 0.5 else pictures
    for axis in (2, 3):
        if rng.random() < 0.5:
            length = 2 * int(rng.integers(8, size // 2 + 1))
            start = 2 * int(rng.integers(0, (size - length) // 2 + 1))
            pictures = np.take(pictures, range(start, start + length), axis)
    return torch.tensor(pictures.astype(np.float32)), told[which]


def report(reader: Reader, shown: np.ndarray, told: Tensor) -> str:
    """Return in words how well the widths of other bursts are read."""
    logs = []
    with torch.no_grad():
        for first in range(len(told) - HELD_OUT, len(told), 200):
            part = slice(first, first + 200)
            logs.append(reader(torch.tensor(shown[part].astype(np.float32)), told[part, 1]))
    p, width_px = torch.cat(logs).exp(), told[-HELD_OUT:, 0]
    mean = p @ WIDTHS_PX
    std = (p @ WIDTHS_PX**2 - mean**2).sqrt()
    error, sure = mean - width_px, std < 0.03
    rms, of_sure = (float(e.square().mean().sqrt()) for e in (error, error[sure]))
    covered = float((error.abs() < 2 * std)[sure].float().mean())
    return (
        f"-log p {loss_of(torch.cat(logs), width_px):.3f}, rms {rms:.4f} px of "
        f"{width_px.std():.4f}; sure of {float(sure.float().mean()):.2f}: rms {of_sure:.4f}, "
        f"inside two std {covered:.3f}\n"
    )


def main() -> None:
    """Draw bursts, then train for some minutes."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("worlds", type=Path)
    ask.add_argument("--count", type=int, default=144000)
    ask.add_argument("--minutes", type=float, default=26)
    ask.add_argument("--out", type=Path, default=Path("response.pt"))
    ask.add_argument("--seed", type=int, default=11)
    ask.add_argument("--threads", type=int, default=2)
    ask.add_argument("--go-on", action="store_true", help="begin with what --out holds")
    given = ask.parse_args()
    torch.set_num_threads(given.threads)
    torch.manual_seed(given.seed)
    shown, told = drawn(given)
    reader, rng = Reader(), np.random.default_rng(given.seed)
    if given.go_on:
        reader.load_state_dict(torch.load(given.out)["solver"])
    optimiser = torch.optim.AdamW(reader.parameters(), LEARNING_RATE, weight_decay=1e-4)
    began, step = time.monotonic(), 0
    while (done := (time.monotonic() - began) / 60 / given.minutes) < 1:
        for group in optimiser.param_groups:
            rise = min(1.0, (step + 1) / 200)
            group["lr"] = LEARNING_RATE * rise * (0.5 + 0.5 * math.cos(math.pi * done) + 0.005)
        pictures, facts = taken(rng, shown, told)
        optimiser.zero_grad()
        loss_of(reader(pictures, facts[:, 1]), facts[:, 0]).backward()
        nn.utils.clip_grad_norm_(reader.parameters(), 1.0)
        optimiser.step()
        step += 1
        if step % 2000 == 0:
            torch.save({"solver": reader.state_dict(), "step": step}, given.out)
            sys.stdout.write(f"{step}: {report(reader, shown, told)}")
            sys.stdout.flush()
    torch.save({"solver": reader.state_dict(), "step": step}, given.out)
    sys.stdout.write(report(reader, shown, told))


if __name__ == "__main__":
    main()
