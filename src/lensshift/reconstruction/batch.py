"""Several bursts at once: on a device those of one geometry go through the solver together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from queue import SimpleQueue
from threading import Lock
from typing import Any

from lensshift.core.types import Burst, Reconstruction
from lensshift.reconstruction.devices import Device, solver_on
from lensshift.reconstruction.learned.solver import Asked, Solution, SolveTogether
from lensshift.reconstruction.reconstruct import reconstruct

# Bursts that are in the memory of a device at a time: 64x16 to 640x480 gain little from more.
TOGETHER = 16


def reconstruct_batch(
    bursts: Iterable[Burst], scale: int = 2, *, device: str | None = None, **settings: Any
) -> list[Reconstruction]:
    """Reconstruct several bursts alike.

    On a device those of one geometry (shape of the frames, shifts, response) are solved at the
    same time, up to sixteen; each result is that of `reconstruct`, to single precision. Tell
    `psf_sigma_px`: a response that is read from the frames is each burst's own.

    Parameters
    ----------
    bursts : as many as you like
    scale, device, settings : of `reconstruct`, the same for all; without a device they are
        reconstructed one after the other

    Raises
    ------
    ValueError, ImportError
        As `reconstruct`, of the first burst that cannot be reconstructed.

    Examples
    --------
    >>> import numpy as np, lensshift
    >>> square = [(-0.25, -0.25), (-0.25, 0.25), (0.25, 0.25), (0.25, -0.25)]
    >>> rng = np.random.default_rng(0)
    >>> bursts = [
    ...     lensshift.Burst.from_arrays(rng.random((4, 6, 8)), offset_px=square, pitch_mm=1.0)
    ...     for _ in range(2)
    ... ]
    >>> pictures = lensshift.reconstruct_batch(bursts, channel="amplitude", noise_sigma=0.3)
    >>> [picture.amplitude.image.shape for picture in pictures]
    [(12, 16), (12, 16)]
    """
    if "streamed" in settings:
        raise ValueError("streamed: the bursts of a batch do not follow each other")
    several = list(bursts)
    if device is None:
        return [reconstruct(burst, scale, **settings) for burst in several]
    solve = solver_on(device)
    found: list[Reconstruction] = []
    for first in range(0, len(several), TOGETHER):
        part = several[first : first + TOGETHER]
        found += _at_once(part, solve, {"scale": scale, **settings}, device)
    return found


def _at_once(
    bursts: Sequence[Burst], solve: SolveTogether, settings: Mapping[str, Any], device: str
) -> list[Reconstruction]:
    """Reconstruct each burst in a thread of its own, and solve here what they ask.

    What happens to a burst before and after, and whether it is solved once or twice, is its own
    affair. All others wait for it until it asks or is done. One thread runs at a time: they are
    there to be interrupted where they ask, and in each other's way they took 1.6 times as long.
    """
    came: SimpleQueue[tuple[Asked, Future[Solution]] | None] = SimpleQueue()
    running = Lock()

    def ask(asked: Asked) -> Solution:
        answer: Future[Solution] = Future()
        came.put((asked, answer))
        running.release()
        try:
            return answer.result()
        finally:
            running.acquire()

    def one(burst: Burst) -> Reconstruction:
        with running:
            try:
                return reconstruct(burst, device=Device(device, ask), **settings)
            finally:
                came.put(None)

    on_the_way, waiting = len(bursts), list[tuple[Asked, Future[Solution]]]()
    with ThreadPoolExecutor(len(bursts)) as threads:
        results = [threads.submit(one, burst) for burst in bursts]
        try:
            while on_the_way or waiting:
                if on_the_way:
                    waiting += [asking] if (asking := came.get()) is not None else []
                    on_the_way -= 1
                    continue
                found = solve([asked for asked, _ in waiting])
                for (_, answer), solution in zip(waiting, found, strict=True):
                    answer.set_result(solution)
                on_the_way, waiting = len(waiting), []
        finally:  # after an error nobody shall wait for an answer that does not come
            waiting += [asking for _ in range(on_the_way) if (asking := came.get()) is not None]
            for _, answer in waiting:
                answer.cancel()
    return [result.result() for result in results]
