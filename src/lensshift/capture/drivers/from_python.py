"""Devices of the user's own, named in a rig file as `module:attribute`, under the same checks.

What they return is looked at, what they raise becomes an error that names them, and what never
returns is left behind, because nobody here knows that code.
"""

from __future__ import annotations

import importlib
import sys
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import fields
from functools import partial
from pathlib import Path
from traceback import TracebackException
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lensshift.capture.drivers.from_callable import frame_from
from lensshift.capture.rig import Camera, CameraFrame, OnHoming, Stage, goal_within
from lensshift.core.arrays import Floats
from lensshift.core.ending import Ended
from lensshift.core.errors import DataError, DeviceError, DeviceTimeout
from lensshift.core.grid import Grid
from lensshift.core.settings import built, fit, parameters, parse_json, to_json

T = TypeVar("T")

# Longer than a lens takes from one end of its way to the other, or a camera to wake up; and than
# anything that moves nothing.
MOST_S = 60.0
_MOST_WORDS = 300  # of an error: some hold all that they could not read
_MOVE = "move_timeout_s"  # entry of a stage that may take longer


def python_stage(
    table: Mapping[str, Any],  # `use = "module:attribute"`, and what the attribute is called with
    folder: Path,  # where modules are looked for first
    *,
    home: str | None = None,
    on_homing: OnHoming | None = None,
) -> Stage:
    """Make the stage that the entry `use` names, called with the other entries and what it takes.

    DataError if there is no such attribute, it does not take the entries, or makes no stage.
    DeviceError if it fails.
    """
    make = _attribute(table, folder, "stage")
    most_s = fit(table.get(_MOVE, MOST_S), float, f"stage.{_MOVE}")
    if not 0 < most_s <= threading.TIMEOUT_MAX:
        raise DataError(f"expected seconds above 0, got {most_s:g}", field=f"stage.{_MOVE}")
    if _MOVE not in parameters(make):
        table = {name: one for name, one in table.items() if name != _MOVE}
    offered = {"home": home, "on_homing": on_homing}
    takes = parameters(make)
    beside = {name: one for name, one in offered.items() if one is not None and name in takes}
    stage = _made(make, table, "stage", Stage, beside)
    return _CheckedStage(stage, str(table["use"]), most_s)


def python_camera(table: Mapping[str, Any], folder: Path) -> Camera:
    """Make the camera that the entry `use` names; else as `python_stage`."""
    camera = _made(_attribute(table, folder, "camera"), table, "camera", Camera, {})
    return _CheckedCamera(camera, str(table["use"]))


def _attribute(table: Mapping[str, Any], folder: Path, what: str) -> Callable[..., Any]:
    name = table.get("use")
    module, _, attribute = name.partition(":") if isinstance(name, str) else ("", "", "")
    if not (module and attribute):
        raise DataError(f'expected "module:attribute", got {name!r:.60}', field=f"{what}.use")
    sys.path.insert(0, str(folder.resolve()))
    try:
        with _Named(f"{what}.use", DataError):
            found: Any = importlib.import_module(module)
            for part in attribute.split("."):
                found = getattr(found, part)
    finally:
        sys.path.remove(str(folder.resolve()))
    if not callable(found):
        raise DataError(f"expected a class or function, {name} is none", field=f"{what}.use")
    return found  # type: ignore[no-any-return]  # callable: just looked


def _made(
    make: Callable[..., Any],
    table: Mapping[str, Any],
    what: str,
    protocol: type,
    beside: Mapping[str, Any],
) -> Any:
    """Call with the entries of a table; return the device if it has all members of a protocol."""
    members = [name for name in vars(protocol) if not name.startswith("_")]
    entries = {name: one for name, one in table.items() if name not in ("kind", "use")}
    with _Named(str(table["use"]), DeviceError):
        device = built(make, entries, what, beside)
        missing = [one for one in members if one not in dir(device)]
    if missing:
        problem = f"{table['use']} makes no {what}: it lacks {', '.join(missing)}"
        raise DataError(problem, field=f"{what}.use")
    return device


class _Named:
    """Makes one line of whatever foreign code raises; our own errors pass as they are.

    But not a DataError while a device is asked for something (`what`): it is about what that gave.
    """

    def __init__(
        self, name: str, kind: type[DataError] | type[DeviceError], what: str = ""
    ) -> None:
        self._name, self._kind, self._what = name, kind, what

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: Any, error: BaseException | None, trace: object) -> None:
        passing = DeviceError | Ended if self._what else DataError | DeviceError | Ended
        # All else, `sys.exit` and what asyncio cancels as well: only Ctrl-C is not of the library.
        if error is not None and not isinstance(error, passing | KeyboardInterrupt):
            said = str(TracebackException(kind, error, None))  # one that cannot be printed as well
            problem = f"{kind.__name__}: {said:.{_MOST_WORDS}}"
            if self._kind is DataError:
                raise DataError(problem, field=self._name) from error
            raise DeviceError(problem, device=self._name, command=self._what) from error


class _Checked:
    """A device of somebody else's; what it does not do is an error that names it."""

    def __init__(self, device: Any, name: str) -> None:
        self._device, self.name = device, name
        self._thread: threading.Thread | None = None
        self.name = self._ask("name", str)

    def _ask(
        self,
        what: str,
        kind: Callable[[Any], T],
        *args: Any,
        most_s: float | None = None,
        cure: str = "",
        at_once: bool = False,
        **options: Any,
    ) -> T:
        """Return a property, or what a method returns, as a kind of value.

        Each call has a thread of its own: if it hangs, that is left. One that was interrupted has
        to end before the next one begins, unless that is needed `at_once`.
        """

        def call() -> T:
            found = getattr(self._device, what)
            return kind(found(*args, **options) if callable(found) else found)

        most_s = most_s or MOST_S
        left, found = None if at_once else self._thread, Future[T]()
        if left is not None:
            left.join(most_s)
        if left is None or not left.is_alive():
            thread = threading.Thread(target=_called, args=(call, found), daemon=True)
            self._thread = self._thread if at_once else thread
            thread.start()
            thread.join(most_s)
            if found.done():
                with _Named(self.name, DeviceError, what):
                    return found.result()
        problem = f"has not returned for {most_s:g} s{cure}"
        raise DeviceTimeout(problem, device=self.name, command=what)

    def _error(self, problem: str, what: str = "") -> DeviceError:
        return DeviceError(problem, device=self.name, command=what)

    def close(self) -> None:
        self._ask("close", type, at_once=True)  # whatever it returns

    def describe(self) -> Mapping[str, Any]:
        # What is kept beside frames is text and numbers: of others, as times, their words.
        return self._ask("describe", lambda told: parse_json(to_json(dict(told))))


def _called(call: Callable[[], T], found: Future[T]) -> None:
    def relay(_: object, error: BaseException | None, __: object) -> bool:
        if error is not None:
            found.set_exception(error)
        return error is not None

    with ExitStack() as relaying:
        relaying.push(relay)
        found.set_result(call())


class _CheckedStage(_Checked):
    """A stage of somebody else's; what it returns is what `Stage` promises, or an error."""

    def __init__(self, stage: Any, name: str, most_s: float) -> None:
        super().__init__(stage, name)
        self._most_s = most_s
        low, high = self.travel_mm.T
        if not np.all(low < high):
            raise self._error("its travel_mm is empty")

    def _numbers(self, what: str, shape: tuple[int, ...], *args: Any, **options: Any) -> Floats:
        values: Floats = self._ask(what, partial(np.asarray, dtype=np.float64), *args, **options)
        if values.shape != shape or not np.all(np.isfinite(values)):
            told = f"{values.tolist()!s:.60}"
            raise self._error(f"expected {list(shape)} finite numbers (mm), got {told}", what)
        return values

    @property
    def travel_mm(self) -> Floats:
        return self._numbers("travel_mm", (2, 2))

    def position_mm(self) -> Floats:
        return self._numbers("position_mm", (2,))

    def move_to(self, position_mm: ArrayLike, *, direct: bool = False) -> Floats:
        goal_mm = goal_within(self.travel_mm, position_mm)
        cure = f" ([stage] {_MOVE})"
        return self._numbers(
            "move_to", (2,), goal_mm, direct=direct, most_s=self._most_s, cure=cure
        )

    def stop(self) -> None:
        self._ask("stop", type, at_once=True)


class _CheckedCamera(_Checked):
    """A camera of somebody else's; what it returns is what `Camera` promises, or an error."""

    _cycle = -1

    @property
    def grid(self) -> Grid:
        return self._ask("grid", lambda found: self._checked("grid", found, Grid))

    @property
    def modulation_hz(self) -> float | None:
        return self._ask("modulation_hz", lambda hz: None if hz is None else float(hz))

    @property
    def intrinsics(self) -> Any:
        with _Named(self.name, DeviceError):
            return getattr(self._device, "intrinsics", None)

    def open(self) -> None:
        self._ask("open", type)
        self._cycle = -1

    def newest_cycle(self) -> int:
        newest = self._ask("newest_cycle", int)
        if newest < self._cycle:  # then frames from before a move would pass for later ones
            problem = f"expected {self._cycle}, of the last frame, or more, got {newest}"
            raise self._error(problem, "newest_cycle")
        return newest

    def next_frame(self, timeout_s: float) -> CameraFrame:
        shot = self._ask("next_frame", self._shot, timeout_s, most_s=timeout_s + MOST_S)
        shape = shot.frame.amplitude.shape
        if shape != self.grid.shape:
            raise self._error(f"expected a frame of {self.grid.shape}, got {shape}", "next_frame")
        if shot.cycle <= self._cycle:
            problem = f"expected a cycle after {self._cycle}, got {shot.cycle}"
            raise self._error(problem, "next_frame")
        self._cycle = shot.cycle
        return shot

    def _shot(self, taken: Any) -> CameraFrame:
        shot = self._checked("next_frame", taken, CameraFrame)
        seen = {one.name: getattr(shot.frame, one.name) for one in fields(shot.frame)}
        frame, raw = frame_from({**shot.raw, **seen})
        return CameraFrame(frame, int(shot.cycle), float(shot.arrived_s), raw)

    def _checked(self, what: str, value: Any, kind: type[T]) -> T:
        if isinstance(value, kind):
            return value
        raise self._error(f"expected a {kind.__name__}, got {type(value).__name__}", what)

    def counts(self) -> Mapping[str, int]:
        return self._ask("counts", lambda told: {str(k): int(n) for k, n in dict(told).items()})
