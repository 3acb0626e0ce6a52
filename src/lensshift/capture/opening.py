"""Open a rig that a TOML file describes; the only place that knows every device."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lensshift.capture.acquire import Acquisition, OnStep, acquire, acquire_at
from lensshift.capture.plan import named_plan
from lensshift.capture.rig import Camera, OnHoming, Stage
from lensshift.capture.rounds import bursts, frames
from lensshift.core.calibration import Calibration
from lensshift.core.errors import DataError
from lensshift.core.lens_field import LensField
from lensshift.core.motion import ShiftPlan, StageMap
from lensshift.core.settings import built, fit, only, parse_toml, read_text, settings_of
from lensshift.core.types import Burst
from lensshift.core.units import doubt_about_units
from lensshift.io.capture_file import FrameRecord

# Lens travel of a quarter pixel of 0.155 mm, with the first lens of the reference design.
QUARTER_PIXEL_MM = 0.0444
CAMERAS = ("o3m", "pcic", "replay", "genicam", "python")
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

_Table = Mapping[str, Any]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class _Nominal:
    """The calibration of a rig file that names no file."""

    px_per_mm: float | tuple[tuple[float, float], tuple[float, float]] = 0.25 / QUARTER_PIXEL_MM
    rest_mm: tuple[float, float] = (3.0, 3.0)
    sigma_px: float = 0.0


@dataclass(slots=True, eq=False)
class Rig:
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
        wanted = named_plan(plan) if isinstance(plan, str) else plan
        return acquire(
            self.stage,
            self.camera,
            wanted,
            self.calibration,
            path,
            self.acquisition,
            resume=resume,
            on_step=on_step,
        )

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
            self.stage,
            self.camera,
            position_mm,
            self.calibration,
            path,
            self.acquisition,
            direct=True,
            plan_name="scan",
            resume=resume,
            on_step=on_step,
        )

    def bursts(self, plan: ShiftPlan | str) -> Iterator[Burst]:
        """Yield one burst after another until the caller stops."""
        wanted = named_plan(plan) if isinstance(plan, str) else plan
        return bursts(self.stage, self.camera, wanted, self.calibration, self.acquisition)

    def frames(self, plan: ShiftPlan | str) -> Iterator[FrameRecord]:
        """Yield one frame after another until the caller stops, see `capture.rounds.frames`."""
        wanted = named_plan(plan) if isinstance(plan, str) else plan
        return frames(self.stage, self.camera, wanted, self.calibration, self.acquisition)

    def close(self) -> None:
        """Stop and let go of everything; a second call does nothing."""
        self._beside.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


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
        camera = _camera(self.camera, self.source, self.folder)
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
        return _stage(self.stage, self.source, self.folder, home, on_homing)


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
    for name in parts:
        if not isinstance(table.get(name, {}), Mapping):
            raise DataError("expected a table", field=name, source=source)
    calibration, lens_field = _calibration(table.get("calibration", {}), source, folder)
    acquisition = _build(Acquisition, table.get("acquisition", {}), "acquisition", source)
    stage, camera = table.get("stage", {}), table.get("camera", {})
    return RigFile(stage, camera, calibration, lens_field, acquisition, source, folder)


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


def _stage(
    table: _Table, source: str, folder: Path, home: str | None, on_homing: OnHoming | None
) -> Stage:
    kind = table.get("kind", "apt")
    if kind == "python":
        from lensshift.capture.drivers.from_python import python_stage

        with settings_of(source):
            return python_stage(table, folder, home=home, on_homing=on_homing)
    if kind != "apt":
        raise DataError(f"expected apt or python, got {kind!r}", field="stage.kind", source=source)
    from lensshift.capture.drivers.apt import AptSettings, open_apt_stage

    if home is not None:
        table = {**table, "home": home}
    missing = [axis for axis in ("row", "col") if axis not in table]
    if missing:
        raise DataError(
            "expected a port or serial number", field=f"stage.{missing[0]}", source=source
        )
    rest = {name: value for name, value in table.items() if name not in ("row", "col", "kind")}
    settings = _build(AptSettings, rest, "stage", source)
    row, col = (_fit(table[axis], str | int, f"stage.{axis}", source) for axis in ("row", "col"))
    return open_apt_stage(str(row), str(col), settings, on_homing)


def _camera(table: _Table, source: str, folder: Path) -> Camera:
    kind = table.get("kind", "o3m")
    rest = {name: value for name, value in table.items() if name != "kind"}
    frequency_hz = _fit(rest.get("modulation_hz"), float | None, "camera.modulation_hz", source)
    doubt = "" if frequency_hz is None else doubt_about_units(frequency_hz, None)
    if doubt:
        raise DataError(doubt, field="camera", source=source)
    if kind == "o3m":
        from lensshift.capture.drivers.o3m import O3MCamera

        return _build(O3MCamera, rest, "camera", source)
    if kind == "pcic":
        from lensshift.capture.drivers.pcic import PcicCamera

        return _build(PcicCamera, rest, "camera", source)
    if kind == "replay":
        from lensshift.capture.drivers.replay import ReplayCamera

        if "path" in rest:
            rest["path"] = folder / _fit(rest["path"], str, "camera.path", source)
        return _build(ReplayCamera, rest, "camera", source)
    if kind == "genicam":
        from lensshift.capture.drivers.genicam import GenicamCamera

        return _build(GenicamCamera, rest, "camera", source)
    if kind == "python":
        from lensshift.capture.drivers.from_python import python_camera

        with settings_of(source):
            return python_camera(table, folder)
    expected = ", ".join(CAMERAS)
    raise DataError(f"expected {expected}, got {kind!r}", field="camera.kind", source=source)


def _calibration(table: _Table, source: str, folder: Path) -> tuple[Calibration, LensField | None]:
    """Return the calibration of a rig file, and the lens field that it is from."""
    if "file" in table:
        from lensshift.io.calibration_file import load_calibration

        file = folder / _fit(table["file"], str, "calibration.file", source)
        return load_calibration(file), None
    if "lens_field" not in table:
        nominal = _build(_Nominal, table, "calibration", source)
        with settings_of(source):
            return nominal_calibration(**asdict(nominal)), None
    from lensshift.io import load_lens_field

    rest = {name: value for name, value in table.items() if name != "lens_field"}
    name = "calibration.lens_field"
    if "px_per_mm" in rest:
        problem = "px_per_mm and lens_field both say how far the image moves; give one of them"
        raise DataError(problem, field=name, source=source)
    nominal = _build(_Nominal, rest, "calibration", source)
    field = load_lens_field(folder / _fit(table["lens_field"], str, name, source))
    if field.unit != "mm":
        problem = "the stages of a rig move in mm, in this lens field an element tilts"
        raise DataError(problem, field=name, source=source)
    told = asdict(nominal) | {"px_per_mm": field.px_per_unit, "optics": field.optics}
    return nominal_calibration(**told), field


def _build(make: Callable[..., T], table: _Table, name: str, source: str) -> T:
    with settings_of(source):
        return built(make, table, name)


def _fit(value: Any, kind: Any, name: str, source: str) -> Any:
    with settings_of(source):
        return fit(value, kind, name)
