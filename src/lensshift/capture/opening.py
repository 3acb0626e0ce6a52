"""Open a rig that a TOML file describes; the only place that knows every device."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lensshift.capture.acquire import Acquisition, OnStep, acquire, acquire_at
from lensshift.capture.plan import named_plan
from lensshift.capture.rig import Camera, OnHoming, Stage
from lensshift.capture.rounds import bursts, frames
from lensshift.core.calibration import Calibration
from lensshift.core.ending import Closing
from lensshift.core.errors import DataError
from lensshift.core.lens_field import LensField
from lensshift.core.motion import ShiftPlan, StageMap
from lensshift.core.settings import built, fit, only, parse_toml, read_text, settings_of, table_of
from lensshift.core.types import Burst
from lensshift.core.units import doubt_about_pitch, doubt_about_units
from lensshift.io.capture_file import FrameRecord

# Lens travel of a quarter pixel of 0.155 mm, with the first lens of the reference design.
QUARTER_PIXEL_MM = 0.0444
_CAMERAS = {  # kind of camera, as its module beside the drivers -> its class there
    "o3m": "O3MCamera", "pcic": "PcicCamera", "replay": "ReplayCamera", "genicam": "GenicamCamera",
}  # fmt: skip
_AXES = ("row", "col")
EXAMPLE = """\
# A rig: two Thorlabs actuators that move the lens, and a camera.

[stage]
row = "83000001"                # USB serial number, device path, or socket://host:port
col = "83000002"                # "row" moves the image up and down, "col" sideways
home = "ask"                    # for the zero: "ask", "if_needed" (unasked), "always", "never"
# counts_per_mm = 34554.96

[camera]
kind = "o3m"                    # o3m, pcic, replay, genicam, python
port = 42000
pitch_mm = 0.155

[calibration]
px_per_mm = 5.63                # image shift over lens travel: a number, or [[.., ..], [.., ..]]
rest_mm = [3.0, 3.0]            # where the lens is centred
# lens_field = "field.nc"       # instead of px_per_mm, from `lensshift lens field`
# file = "calibration.json"     # instead of all of these, from `lensshift calibrate`

[acquisition]
frames = 1                      # kept at each position
average = false
discard = 2                     # frames that may have begun before the stage had settled
"""

# Beyond anything that has been built: nanometres for mm, or a slip of the keys.
_MOST_PX_PER_MM, _MOST_REST_MM = 1e4, 1e3
_UNITS = {"px_per_mm": "pixels of image for a mm of lens", "rest_mm": "places in mm"}
_Table = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class _Nominal:
    """The calibration of a rig file that names no file."""

    px_per_mm: float | tuple[tuple[float, float], tuple[float, float]] = 0.25 / QUARTER_PIXEL_MM
    rest_mm: tuple[float, float] = (3.0, 3.0)
    sigma_px: float = 0.0

    def __post_init__(self) -> None:
        for name, most in (("px_per_mm", _MOST_PX_PER_MM), ("rest_mm", _MOST_REST_MM)):
            if not np.all(np.abs(getattr(self, name)) <= most):
                told = f"up to {most:g}, got {getattr(self, name)}"
                raise ValueError(f"{name}: expected {_UNITS[name]}, {told}")


@dataclass(slots=True, eq=False)
class Rig(Closing):
    """An open rig: `with open_rig("rig.toml") as rig: burst = rig.capture("square", "burst.nc")`.

    On any exit the stage stands still and devices are let go.

    Parameters
    ----------
    stage, camera : open devices
    calibration : from image offsets to stage positions
    acquisition : how frames are taken
    """

    stage: Stage
    camera: Camera
    calibration: Calibration
    acquisition: Acquisition = field(default_factory=Acquisition)
    _beside: ExitStack = field(default_factory=ExitStack)

    def capture(
        self,
        plan: ShiftPlan | str,
        path: str | Path,
        *,
        resume: bool = False,
        on_step: OnStep | None = None,
    ) -> Burst:
        """Take the burst of a plan, see `lensshift.capture.acquire.acquire`."""
        return acquire(
            self.stage, self.camera, _plan(plan), self.calibration, path, self.acquisition,
            resume=resume, on_step=on_step,
        )  # fmt: skip

    def scan(
        self,
        position_mm: ArrayLike,
        path: str | Path,
        *,
        resume: bool = False,
        on_step: OnStep | None = None,
    ) -> Burst:
        """Take the positions of `lensshift.registration.calibration_scan_mm`, for `calibrate`.

        The stage goes straight from one to the next, so that the scan shows its play.
        """
        return acquire_at(
            self.stage, self.camera, position_mm, self.calibration, path, self.acquisition,
            direct=True, plan_name="scan", resume=resume, on_step=on_step,
        )  # fmt: skip

    def bursts(self, plan: ShiftPlan | str) -> Iterator[Burst]:
        """Yield one burst after another until the caller stops."""
        return bursts(self.stage, self.camera, _plan(plan), self.calibration, self.acquisition)

    def frames(self, plan: ShiftPlan | str) -> Iterator[FrameRecord]:
        """Yield one frame after another until the caller stops, see `capture.rounds.frames`."""
        return frames(self.stage, self.camera, _plan(plan), self.calibration, self.acquisition)

    def close(self) -> None:
        """Stop and let go of everything; a second call does nothing."""
        self._beside.close()


def _plan(plan: ShiftPlan | str) -> ShiftPlan:
    return named_plan(plan) if isinstance(plan, str) else plan


def open_rig(
    config: str | Path | _Table, *, home: str | None = None, on_homing: OnHoming | None = None
) -> Rig:
    """Open the devices that a rig file describes; `opening.EXAMPLE` shows one.

    Axes that do not know their zero are homed only with leave: homing takes the lens to the end of
    its way.

    Parameters
    ----------
    config : TOML file, or what is in one
    home : instead of `stage.home` of the rig file: "if_needed" gives leave, "never" moves nothing
    on_homing : hears how far each axis will go before it is homed; with `home = "ask"` it gives
        leave by returning True

    Raises
    ------
    DataError
        If the file is missing, no TOML, or describes no rig: with file and field.
    DeviceError
        If a device is not there or fails, or there is no leave to home it.
    """
    told = read_rig(config)
    with ExitStack() as opening:
        camera = told.open_camera()
        opening.callback(camera.close)
        stage = told.open_stage(home, on_homing)
        opening.callback(stage.close)
        return Rig(stage, camera, told.calibration, told.acquisition, opening.pop_all())


@dataclass(frozen=True, slots=True, eq=False)
class RigFile:
    """What a rig file says; nothing is open yet.

    Parameters
    ----------
    stage, camera : their tables
    calibration, lens_field : from image offsets to stage positions, and what that follows from
    acquisition : how frames are taken
    source, folder : name of the file, and where its relative paths begin
    """

    stage: _Table
    camera: _Table
    calibration: Calibration
    lens_field: LensField | None
    acquisition: Acquisition
    source: str
    folder: Path

    def open_camera(self) -> Camera:
        """Return the camera, receiving.

        Raises
        ------
        DataError
            If the table describes none, or not the one of the lens field.
        DeviceError
            If it cannot be had.
        """
        with settings_of(self.source):
            camera = _camera(self.camera, self.folder)
        with ExitStack() as opening:
            opening.callback(camera.close)
            camera.open()
            if self.lens_field is not None:
                with settings_of(self.source):
                    self.lens_field.check_sensor(camera.grid)
            opening.pop_all()
        return camera

    def open_stage(self, home: str | None = None, on_homing: OnHoming | None = None) -> Stage:
        """Return the stage, homed if it has leave; `home` and `on_homing` as in `open_rig`."""
        with settings_of(self.source):
            return _stage(self.stage, self.folder, home, on_homing)


def read_rig(config: str | Path | _Table) -> RigFile:
    """Return what a rig file says, without opening anything.

    Raises
    ------
    DataError
        If the file is missing, no TOML, or describes no rig: with file and field.
    """
    if isinstance(config, Mapping):
        table, source, folder = config, "rig", Path()
    else:
        table = parse_toml(read_text(config), config)
        source, folder = str(config), Path(config).parent
    parts = ("stage", "camera", "calibration", "acquisition")
    with settings_of(source):
        only(table, parts)
        stage, camera, calibration, acquisition = (table_of(table, name) for name in parts)
        settings = built(Acquisition, acquisition, "acquisition")
        return RigFile(stage, camera, *_calibration(calibration, folder), settings, source, folder)


def nominal_calibration(
    px_per_mm: float | ArrayLike = 0.25 / QUARTER_PIXEL_MM,
    rest_mm: ArrayLike = (3.0, 3.0),
    *,
    sigma_px: float = 0.0,
    optics: Mapping[str, Any] | None = None,
) -> Calibration:
    """Return the calibration that follows from the optics, before anything is measured.

    Parameters
    ----------
    px_per_mm : image shift over lens travel, one number or [2 2]
    rest_mm : [2] where the lens is centred
    optics : which lens that is, see `LensField.optics`
    """
    per_mm = np.asarray(px_per_mm, dtype=np.float64)
    square = per_mm * np.eye(2) if per_mm.ndim == 0 else per_mm
    notes = {} if optics is None else {"optics": dict(optics)}
    return Calibration(StageMap(square, sigma_px=sigma_px), np.asarray(rest_mm), notes=notes)


def _stage(table: _Table, folder: Path, home: str | None, on_homing: OnHoming | None) -> Stage:
    kind = fit(table.get("kind", "apt"), str, "stage.kind")
    if kind == "python":
        from lensshift.capture.drivers.from_python import python_stage

        return python_stage(table, folder, home=home, on_homing=on_homing)
    if kind != "apt":
        raise DataError(f"expected apt or python, got {kind!r}", field="stage.kind")
    from lensshift.capture.drivers.apt import AptSettings, open_apt_stage

    if home is not None:
        table = {**table, "home": home}
    row, col = (str(fit(table.get(axis, ""), str | int, f"stage.{axis}")) for axis in _AXES)
    for axis, port in zip(_AXES, (row, col), strict=True):
        if not (port and port.isprintable()):
            raise DataError("expected a serial number, path or URL", field=f"stage.{axis}")
    rest = {name: value for name, value in table.items() if name not in (*_AXES, "kind")}
    settings = built(AptSettings, rest, "stage")
    if row == col:
        raise DataError(f"expected a port other than that of row, {row!r}", field="stage.col")
    return open_apt_stage(row, col, settings, on_homing)


def _camera(table: _Table, folder: Path) -> Camera:
    kind = fit(table.get("kind", "o3m"), str, "camera.kind")
    rest = {name: value for name, value in table.items() if name != "kind"}
    frequency_hz = fit(rest.get("modulation_hz"), float | None, "camera.modulation_hz")
    doubt = "" if frequency_hz is None else doubt_about_units(frequency_hz, None)
    pitch_mm = rest.get("pitch_mm")
    if kind != "python" and isinstance(pitch_mm, int | float):
        doubt = doubt or doubt_about_pitch(pitch_mm)
    if doubt:
        raise DataError(doubt, field="camera")
    if kind == "python":
        from lensshift.capture.drivers.from_python import python_camera

        return python_camera(table, folder)
    if kind not in _CAMERAS:
        expected = ", ".join((*_CAMERAS, "python"))
        raise DataError(f"expected {expected}, got {kind!r}", field="camera.kind")
    if kind == "replay" and "path" in rest:
        rest["path"] = folder / fit(rest["path"], str, "camera.path")
    make = getattr(import_module(f"lensshift.capture.drivers.{kind}"), _CAMERAS[kind])
    camera: Camera = built(make, rest, "camera")
    return camera


def _calibration(table: _Table, folder: Path) -> tuple[Calibration, LensField | None]:
    """Return the calibration of a rig file, and the lens field that it is from."""
    if "file" in table:
        from lensshift.io.calibration_file import load_calibration

        return load_calibration(folder / fit(table["file"], str, "calibration.file")), None
    if "lens_field" not in table:
        return nominal_calibration(**asdict(built(_Nominal, table, "calibration"))), None
    from lensshift.io import load_lens_field

    rest = {name: value for name, value in table.items() if name != "lens_field"}
    name = "calibration.lens_field"
    if "px_per_mm" in rest:
        problem = "px_per_mm and lens_field both say how far the image moves; give one of them"
        raise DataError(problem, field=name)
    nominal = built(_Nominal, rest, "calibration")
    field = load_lens_field(folder / fit(table["lens_field"], str, name))
    if field.unit != "mm":
        problem = "the stages of a rig move in mm, in this lens field an element tilts"
        raise DataError(problem, field=name)
    told = asdict(nominal) | {"px_per_mm": field.px_per_unit, "optics": field.optics}
    return nominal_calibration(**told), field
