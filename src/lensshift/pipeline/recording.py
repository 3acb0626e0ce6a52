"""A recording of any length to a sequence of pictures, on as many workers as there are."""

from __future__ import annotations

import logging
import math
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.errors import DataError, QualityWarning, about, of_extra
from lensshift.core.types import Burst, Frame, Reconstruction
from lensshift.io.burst_file import Recording, open_recording
from lensshift.io.container_writer import software
from lensshift.io.result_file import CHANNELS
from lensshift.io.sequence_file import PiecewiseFile, begin_sequence, of_sequence, otherwise
from lensshift.reconstruction.reconstruct import reconstruct
from lensshift.reconstruction.stream import Pace, stream

# What one task reads and returns is at most of this size, so that memory is bounded; a task is also
# what is lost with a worker, and where nothing is known of what was before.
TASK_BYTES, MOST_WINDOWS = 16_000_000, 256
SAME_PLACE_PX = 1e-9  # rounding
AHEAD = 3  # tasks for each worker that are under way
RETRIES = 3  # of a task whose worker died
NOTHING = "none of its frames shows anything"
SAID = 3  # contradictions of a task that are told in words


@dataclass(frozen=True, slots=True)
class Windows:
    """What is done with a recording; a worker needs no more.

    state : what the recording and the program are by, whose pictures go together, see `_state`
    response : width of the pixel response that the example showed, with its error, as in `meta`
    layout : shape and dtype of each field of a picture, those of the example
    """

    recording: str  # burst file, at a path that all workers know
    window: int  # frames of a picture
    every: int  # from the first frame of a picture to that of the next
    count: int  # pictures
    example: int  # first frame of a window that shows something
    scale: int
    method: str
    pace: Pace
    state: Mapping[str, Any]
    settings: Mapping[str, Any] = field(default_factory=dict)  # of `stream`
    response: Mapping[str, float] = field(default_factory=dict)
    layout: Mapping[str, tuple[tuple[int, ...], str]] = field(default_factory=dict)

    def burst(self, source: Recording, first: int, count: int) -> Burst:
        """Return frames that tell the response."""
        burst = source.burst(first, count)
        return replace(burst, meta=dict(burst.meta) | dict(self.response))

    def streams(self, template: Burst, burst: Burst | None, start: int) -> bool:
        """Tell whether a stream serves: the shifts of frames from `start` on are the example's.

        It has one frequency, and knows of no turns.
        """
        if burst is None or burst.phasors is not None or burst.affine is not None:
            return False
        places = np.arange(start, start + burst.frame_count) % self.window
        return bool(np.abs(burst.offset_px - template.offset_px[places]).max() <= SAME_PLACE_PX)


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """Pictures of consecutive windows, as the file keeps them, and what was wrong with them."""

    first: int
    fields: dict[str, Array]
    said: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SequenceSummary:
    """What became of a recording."""

    path: Path
    windows: int  # pictures in the file
    resumed: int  # and how many of them were there before
    contradicted: int  # pictures that their frames contradict, of those made now
    said: tuple[str, ...]  # what was wrong, the first few
    seconds: float


def reconstruct_recording(
    recording: str | Path,
    out: str | Path,
    scale: int = 2,
    method: str = "auto",
    *,
    window: int = 4,
    every: int | None = None,
    pace: Pace = "auto",
    workers: int | None = None,
    scheduler: str | None = None,
    on_progress: Callable[[int, int], None] | None = None,
    **settings: Any,
) -> SequenceSummary:
    """Make a picture of each window of frames of a recording that may be larger than memory.

    Pictures are written as they come. After a break the same call goes on where it was; the result
    does not depend on the workers, nor on breaks.

    Parameters
    ----------
    recording : burst file of any length
    out : file of the sequence (see `lensshift.io.sequence_file`), `out`.part until it is complete
    window : frames of each picture
    every : frames from one picture to the next; by default `window`, each frame is in one picture
    pace : as in `lensshift.stream`, which serves where the shifts return after each window; other
        windows are reconstructed each on its own
    workers : processes of dask.distributed to start; None: all is done here
    scheduler : address of a dask scheduler instead, whose workers can read the recording
    on_progress : called with the windows done, and all of them
    settings : of `reconstruct`, the same for all windows

    Raises
    ------
    DataError
        If a file cannot be read or written, or `out` was begun otherwise, by another version of
        the package too, or the recording changes meanwhile.
    ValueError
        If the recording is shorter than a window, or a setting is wrong.
    RuntimeError
        If workers died at the same task again and again; what was done is kept.
    ImportError
        If workers are asked for and dask.distributed is not installed.
    """
    started_s, bad = time.perf_counter(), 0
    said: list[tuple[int, str]] = []
    with ExitStack() as stack:
        source = stack.enter_context(open_recording(recording))
        step = window if every is None else every
        if window < 1 or step < 1:
            raise ValueError(f"expected window and every from 1, got {window} and {step}")
        if source.frame_count < window:
            raise ValueError(f"expected at least {window} frames, got {source.frame_count}")
        count = (source.frame_count - window) // step + 1
        example = _showing(source, window)
        place = str(Path(recording).resolve())
        job = Windows(
            place, window, step, count, example, scale, method, pace, _state(place), dict(settings)
        )
        job, file, tasks = _begun(stack, source, job, out)
        resumed = done = int(file.written.sum())
        solved: Iterator[Solved] = (solve_windows(job, first, count) for first, count in tasks)
        if workers is not None or scheduler is not None:
            solved = _solved_by_dask(job, tasks, workers, scheduler)
        for one in solved:
            file.write(one.first, one.fields)
            said.extend((one.first, text) for text in one.said)
            bad += int(one.fields["contradicted"].sum())
            done += len(one.fields["contradicted"])
            if on_progress is not None:
                on_progress(done, job.count)
        path = file.finish()
    seconds = time.perf_counter() - started_s
    first = tuple(text for _, text in sorted(said, key=itemgetter(0))[:SAID])  # come in any order
    return SequenceSummary(path, job.count, resumed, bad, first, seconds)


def solve_windows(job: Windows, first: int, count: int) -> Solved:
    """Return the pictures of some windows; what a worker does."""
    start, length = first * job.every, (count - 1) * job.every + job.window
    with open_recording(job.recording) as source:
        template = job.burst(source, job.example, job.window)
        shown = source.shown(start, length)
        burst = job.burst(source, start, length) if shown.any() else None
        time_s = source.time_s(start, length)
    if other := otherwise(job.state, _state(job.recording)):
        problem = f"another recording or program than the pictures were begun with ({other})"
        raise DataError(f"{problem}; give the output another name", source=job.recording)
    rows: list[dict[str, Array]] = []
    said: list[str] = []
    for number, (found, wrong) in enumerate(_pictures(job, template, burst, shown, start, count)):
        part = slice(number * job.every, number * job.every + job.window)
        when_s = np.nan if time_s is None else float(np.mean(time_s[part]))
        rows.append({
            **_laid_out(job, found, wrong),
            "first_frame": np.array(start + part.start),
            "time": np.array(when_s),
            "refined": np.array(found is None or found.settings.get("pace") != "live"),
        })  # fmt: skip
        said.extend(f"window {first + number}: {text}" for text in wrong)
    fields = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    return Solved(first, fields, tuple(said[:SAID]))


def _state(recording: str) -> dict[str, Any]:
    """Return what tells a recording from another one of its name, and who makes the pictures."""
    told = Path(recording).stat()
    return {"bytes": told.st_size, "changed_ns": told.st_mtime_ns, "software": software()}


def _pictures(
    job: Windows, template: Burst, burst: Burst | None, shown: Array, start: int, count: int
) -> Iterator[tuple[Reconstruction | None, list[str]]]:
    """Yield the picture of each window, None where nothing shows, and what was said of it."""
    told: dict[str, Any] = {"scale": job.scale, "method": job.method} | dict(job.settings)
    streams = job.streams(template, burst, start)
    camera = stream(template, pace=job.pace, **told) if streams else None
    taken = 0
    for number in range(count):
        begin = number * job.every
        if burst is None or not shown[begin : begin + job.window].any():
            yield None, [NOTHING]
            continue
        frames = f"frames {start + begin} to {start + begin + job.window - 1}"
        with (
            about(frames),
            warnings.catch_warnings(record=True, action="always", category=QualityWarning) as said,
        ):
            if camera is None:
                found = reconstruct(burst.select(range(begin, begin + job.window)), **told)
            else:
                for k in range(max(taken, begin), begin + job.window):
                    distance_m = None if burst.distance_m is None else burst.distance_m[k]
                    valid = burst.valid[k] & shown[k]  # as the stream may not see that none shows
                    frame = Frame(burst.amplitude[k], distance_m, valid, math.nan)
                    camera.take(frame, place=(start + k) % job.window)
                taken = begin + job.window
                found = camera.picture()
        yield found, [str(one.message) for one in said]


def _laid_out(job: Windows, found: Reconstruction | None, said: list[str]) -> dict[str, Array]:
    """Return the fields of a picture; those it does not have, as one of nothing, have no number.

    Parameters
    ----------
    said : what was said of it, to which what it does not have is added
    """
    blank = {
        name: np.full(shape, np.nan if np.dtype(dtype).kind == "f" else 0, dtype)
        for name, (shape, dtype) in job.layout.items()
    }
    if found is None:
        return blank | {"contradicted": np.array(True)}
    fields = of_sequence(found)
    said.extend(f"its frames tell no {name}" for name in CHANNELS if name in blank.keys() - fields)
    return {name: fields.get(name, nothing) for name, nothing in blank.items()}


def _showing(source: Recording, window: int) -> int:
    """Return where the first window is, side by side, that shows anything."""
    starts = range(0, source.frame_count - window + 1, window)
    found = next((one for one in starts if source.shown(one, window).any()), None)
    if found is None:
        raise ValueError("none of its frames shows anything: all valid pixels are alike")
    return found


def _begun(
    stack: ExitStack, source: Recording, job: Windows, out: str | Path
) -> tuple[Windows, PiecewiseFile, list[tuple[int, int]]]:
    """Return the job, with the pixel response of its first window, the file, and the tasks left."""
    template = source.burst(job.example, job.window)
    stream(template, job.scale, job.method, pace=job.pace, **dict(job.settings))  # refuses
    with warnings.catch_warnings(action="ignore", category=QualityWarning):
        example = reconstruct(template, job.scale, job.method, **dict(job.settings))
    if example.settings["psf_source"] == "frames":
        read = {name: example.settings[name] for name in ("psf_sigma_px", "psf_std_px")}
        job = replace(job, response=read)
    if any(np.iscomplexobj(one.image) for one in example.channels.values()):
        problem = f"the frames are complex, and so would be their pictures by {example.method}"
        cure = "take channel phasor of method auto, tikhonov or tv"
        if template.modulation_hz is None:
            cure = "tell the modulation: lensshift convert IN OUT --modulation-hz 20e6 says 20 MHz"
        raise ValueError(f"{problem}; a sequence holds amplitudes and distances: {cure}")
    like = of_sequence(example)
    settings = asdict(job) | {"frames": source.frame_count} | dict(job.state)
    del settings["layout"], settings["state"]  # the file has the one, and the other here
    file = stack.enter_context(
        begin_sequence(
            out, job.count, example.grid, tuple(example.channels), scale=example.scale,
            method=example.method, settings=settings, flying=example.flying is not None,
            intrinsics=example.intrinsics,
        )
    )  # fmt: skip
    layout = {name: (one.shape, one.dtype.str) for name, one in like.items()}
    job = replace(job, layout=layout)
    # Of a picture, and of the frames from one to the next, which a task reads together.
    frames = [template.amplitude, template.valid, template.distance_m]
    apart = sum(one.nbytes for one in frames if one is not None) * job.every // job.window
    each = max(sum(one.nbytes for one in like.values()), apart)
    size = int(np.clip(TASK_BYTES // each, 1, MOST_WINDOWS))
    tasks = [(first, min(size, job.count - first)) for first in range(0, job.count, size)]
    return job, file, [(f, n) for f, n in tasks if not file.written[f : f + n].all()]


def _of_workers() -> dict[str, Any]:
    """Return the settings of dask that workers of these tasks are started with.

    One that watches itself keeps what it saw of each second of an hour: 0.4 MB each. And dask lets
    them hand each large array back to the system, which costs a sixth of their time.
    """
    place = "distributed.nanny.pre-spawn-environ"
    told = dict(import_module("dask").config.get(place, {}))
    told.pop("MALLOC_TRIM_THRESHOLD_", None)
    return {"distributed.worker.profile.enabled": False, place: told}


def _address(scheduler: str) -> str:
    """Return the address of a scheduler; ValueError if it is none."""
    addressing = import_module("distributed.comm.addressing")
    try:  # else a client tries for a minute to close what it has not opened
        return str(addressing.resolve_address(scheduler))
    except (ValueError, OSError) as error:
        problem = f"expected the address of a dask scheduler as in tcp://10.0.0.5:8786: {error}"
        raise ValueError(problem) from error


def _solved_by_dask(
    job: Windows, tasks: list[tuple[int, int]], workers: int | None, scheduler: str | None
) -> Iterator[Solved]:
    """Yield what workers solved, as it comes; what a dying one was at is given to another."""
    needed = "workers need dask.distributed: pip install 'lensshift[cluster]'"
    distributed = of_extra("distributed", needed)
    with ExitStack() as stack:
        if scheduler is not None:
            where: Any = _address(scheduler)
        else:
            stack.enter_context(import_module("dask").config.set(_of_workers()))
            where = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    dashboard_address=None,
                    # Its other pages stay: at a free port, as a second cluster has to take one.
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                    silence_logs=logging.CRITICAL,
                )
            )
        client = stack.enter_context(distributed.Client(where, set_as_default=False))
        there = len(client.nthreads())  # of all workers; `scheduler_info` may tell five
        if not there:
            text = f"the scheduler at {where} has no workers yet: waiting for the first"
            warnings.warn(text, QualityWarning, stacklevel=3)
        ahead = AHEAD * max(1, there)
        left = (
            client.submit(solve_windows, job, first, count, pure=False, retries=RETRIES)
            for first, count in tasks
        )
        under_way = distributed.as_completed(list(islice(left, ahead)), loop=client.loop)
        for future in under_way:
            try:
                solved = future.result()
            except distributed.KilledWorker as error:
                raise RuntimeError(
                    f"workers died {RETRIES + 1} times at the same task, as where memory runs out; "
                    "what was done is kept, and the same call with fewer workers goes on with it"
                ) from error
            yield solved
            future.release()
            under_way.update(list(islice(left, 1)))
