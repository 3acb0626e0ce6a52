"""Train the prior of the unrolled solver; resumable, seeds fixed.

python training/worlds.py --count 6000 --seed 1 --out worlds.npy
python training/train.py worlds.npy --minutes 120 --out solver.pt
python training/depths.py --count 3000 --seed 2 --out depths.npy
python training/train.py depths.npy --minutes 60 --phasor --out phasor.pt
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from itertools import count
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
from bursts import draw_batch, draw_phasors
from export import load_exported
from graphs import Replays
from network import Solver, facts_of
from phasor_network import PhasorSolver
from torch.nn import functional

from lensshift.reconstruction.learned.network import learned_weights

BATCH = 16
LEARNING_RATE = 1.5e-3
BORDER = 2  # HR pixels left out of the loss
FLOOR = 1e-7  # mean squared error that counts as none
LOCAL = 5  # HR pixels along the window of a local mean of the error
FAINT = 0.02  # amplitude below which a phasor has no phase to get wrong


def loss_of(found: list[torch.Tensor], std: torch.Tensor, truth: torch.Tensor) -> tuple:
    """Return what is minimised and the mean PSNR of the last estimate."""
    inner = (slice(None), slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    error = [(x - truth)[inner] for x in found]
    logs = [torch.log((e * e).mean((1, 2)) + FLOOR).mean() for e in error]
    last, s = error[-1].detach(), std[inner]
    s = torch.sqrt(s * s + 1e-8)
    likelihood = (torch.log(s) + 0.5 * torch.clamp((last / s) ** 2, max=50.0)).mean()
    early = sum(logs[1:-1]) / max(len(logs) - 2, 1)
    return logs[-1] + 0.15 * early + 0.1 * likelihood, -4.343 * logs[-1].detach()


def loss_of_phasors(found: list[torch.Tensor], spread: torch.Tensor, truth: torch.Tensor) -> tuple:
    """Return what is minimised, and the rms of the error of the last estimate over the truth, dB.

    The error counts as it is, over the amplitude, and by the logarithm of its local mean square:
    dark surfaces have a distance as well, and quiet ones count beside edges.
    """
    inner = (..., slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    power = (truth[inner] ** 2).sum(1)
    logs = []
    for x in found:
        square = ((x - truth)[inner] ** 2).sum(1)
        share = torch.clamp(square / (power + FAINT**2), max=4.0).mean((1, 2))
        local = torch.log(functional.avg_pool2d(square, LOCAL, LOCAL // 2) + FLOOR).mean((1, 2))
        logs.append(
            torch.log(square.mean((1, 2)) + FLOOR) + 0.7 * torch.log(share + 1e-6) + 1.5 * local
        )
    means = [log.mean() for log in logs]
    error = (found[-1].detach() - truth)[inner]
    u = found[-1].detach()[inner]
    u = u / (u.norm(dim=1, keepdim=True) + 1e-9)
    along = error[:, 0] * u[:, 0] + error[:, 1] * u[:, 1]
    across = error[:, 1] * u[:, 0] - error[:, 0] * u[:, 1]
    log_along, log_across, both = spread[inner].unbind(1)
    a, b, rest = along / log_along.exp(), across / log_across.exp(), 1 - both**2
    misfit = torch.clamp((a * a - 2 * both * a * b + b * b) / rest, max=50.0)
    likelihood = (log_along + log_across + 0.5 * torch.log(rest) + 0.5 * misfit).mean()
    early = sum(means[1:-1]) / max(len(means) - 2, 1)
    shown = -4.343 * torch.log(share).mean().detach()
    return means[-1] + 0.15 * early + 0.1 * likelihood, shown


def drawn(given: argparse.Namespace, first: int) -> Iterator[tuple[int, list[torch.Tensor]]]:
    """Yield scale and tensors of batches, drawn by other processes, the same in every run."""
    ahead = 6 * given.workers
    # Processes that are not forked: this one may hold a GPU.
    with ProcessPoolExecutor(given.workers, get_context("spawn")) as workers:
        waiting = deque(workers.submit(_draw, given, first + k) for k in range(ahead))
        for number in count(first + ahead):
            scale, arrays = waiting.popleft().result()
            waiting.append(workers.submit(_draw, given, number))
            yield scale, [torch.from_numpy(values) for values in arrays]


@lru_cache(maxsize=1)
def _pool(worlds: Path) -> np.ndarray:
    torch.set_num_threads(1)
    return np.load(worlds, mmap_mode="r")


def _draw(given: argparse.Namespace, number: int) -> tuple[int, list[np.ndarray]]:
    rng, pool = np.random.default_rng((given.seed, number)), _pool(given.worlds)
    draw = draw_phasors if given.phasor else draw_batch
    batch = draw(rng, pool, BATCH, given.square)
    facts = facts_of(batch.blur_hr_px, batch.scale, len(batch.rows))
    seen = (batch.frames, batch.valid, batch.sigma, batch.rows, batch.cols, facts, batch.truth)
    return batch.scale, [values.numpy() for values in seen]


def rate(step: int, done: float) -> float:
    """Return the learning rate: a short rise, then half a cosine over the time that is given."""
    return (
        LEARNING_RATE * min(1.0, (step + 1) / 300) * (0.5 + 0.5 * math.cos(math.pi * done) + 0.005)
    )


def main() -> None:
    """Train for some minutes, writing weights and optimiser every few hundred steps."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("worlds", type=Path)
    ask.add_argument("--minutes", type=float, default=120)
    ask.add_argument("--out", type=Path, default=Path("solver.pt"))
    ask.add_argument("--seed", type=int, default=0)
    ask.add_argument("--threads", type=int, default=1)
    ask.add_argument("--device", default="cpu", help="'cuda' for a GPU")
    ask.add_argument("--workers", type=int, default=1, help="processes that draw bursts")
    ask.add_argument("--batches", type=int, default=1, help=f"of {BATCH} bursts in a step")
    ask.add_argument("--peak", type=float, default=1.0, help="factor of the learning rate")
    ask.add_argument("--phasor", action="store_true", help="train the solver for phasors")
    ask.add_argument("--square", action="store_true", help="four frames on the usual square alone")
    ask.add_argument("--go-on", action="store_true", help="begin with the weights of the package")
    given = ask.parse_args()
    torch.set_num_threads(given.threads)
    torch.manual_seed(given.seed)
    solver = (PhasorSolver() if given.phasor else Solver()).to(given.device)
    optimiser = torch.optim.AdamW(solver.parameters(), LEARNING_RATE, weight_decay=1e-4)
    stored = None
    if given.out.exists():
        stored = torch.load(given.out, map_location=given.device)
        solver.load_state_dict(stored["solver"])
        optimiser.load_state_dict(stored["optimiser"])
    elif given.go_on:
        kind = "phasor" if given.phasor else "square" if given.square else "brightness"
        load_exported(solver, *learned_weights(kind))
    train(given, solver, optimiser, stored["step"] if stored else 0)


def train(
    given: argparse.Namespace, solver: torch.nn.Module, optimiser: torch.optim.Optimizer, step: int
) -> None:
    """Go on from a step until the time is over."""
    for p in solver.parameters():
        p.grad = torch.zeros_like(p)
    judge = loss_of_phasors if given.phasor else loss_of

    def learn(scale: int, tensors: list[torch.Tensor]) -> torch.Tensor:
        *seen, truth = tensors
        loss, shown_db = judge(*solver(*seen, scale), truth)
        (loss / given.batches).backward()
        return shown_db

    if given.device != "cpu":
        learn = Replays(solver, learn)
    batches, shown, bad = drawn(given, given.batches * step), [], 0
    ready = next(batches)  # the time begins when the first is there
    began = time.monotonic()
    while (done := (time.monotonic() - began) / 60 / given.minutes) < 1:
        for group in optimiser.param_groups:
            group["lr"] = given.peak * rate(step, done)
        optimiser.zero_grad(set_to_none=False)
        for _ in range(given.batches):
            shown.append(learn(*ready))
            ready = next(batches)
        norm = torch.nn.utils.clip_grad_norm_(solver.parameters(), 1.0)
        if torch.isfinite(norm):
            optimiser.step()
        else:
            bad += 1
        step += 1
        if step % 200 == 0:
            spent, mean_db = time.monotonic() - began, torch.stack(shown).mean().item()
            sys.stdout.write(f"{step} {spent:.0f} s {mean_db:.3f} dB, {bad} left out\n")
            sys.stdout.flush()
            shown = []
            torch.save(stored_of(solver, optimiser, step), given.out)
    sys.stdout.write(f"{step} steps\n")
    torch.save(stored_of(solver, optimiser, step), given.out)


def stored_of(solver: Solver, optimiser: torch.optim.Optimizer, step: int) -> dict:
    """Return all that a later run needs to go on."""
    return {"solver": solver.state_dict(), "optimiser": optimiser.state_dict(), "step": step}


if __name__ == "__main__":
    main()
