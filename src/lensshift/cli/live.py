"""`lensshift live`: pictures as the frames come, in a browser."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.devices import YesOption, homing_asked
from lensshift.cli.inputs import parse_pitch_mm
from lensshift.cli.session import DebugOption, JsonOption, Session, session

if TYPE_CHECKING:
    from lensshift.capture.drivers.replay import ReplayCamera
    from lensshift.live.sources import Source

RigOption = Annotated[str | None, typer.Option("--rig", help="Rig file (TOML), or: emulated.")]
ReplayOption = Annotated[
    Path | None, typer.Option("--replay", help="Burst file, capture, pcap, pcapng or ROS bag.")
]
SimulateOption = Annotated[
    str | None, typer.Option("--simulate", help="Scene by name, scene or experiment file (TOML).")
]
PatternOption = Annotated[
    str, typer.Option("--pattern", help="square, 3x3, 4x4, quincunx, spiral or still.")
]
ScaleOption = Annotated[int, typer.Option("--scale", min=1, max=8, help="HR pixels per pixel.")]
MethodOption = Annotated[str, typer.Option("--method", help="As of `reconstruct`.")]
BlurOption = Annotated[
    float | None,
    typer.Option("--blur-px", min=0.0, help="Width of the pixel response; else what is known."),
]
RateOption = Annotated[
    float, typer.Option("--rate-hz", min=0.1, help="Frames a second of --simulate and bursts.")
]
CalibrationOption = Annotated[
    Path | None, typer.Option("--calibration", help="From `calibrate`; instead of the rig file's.")
]
PitchOption = Annotated[
    str, typer.Option("--pitch-mm", help="Pixel pitch of a pcap or bag: one number, or row,col.")
]
ModulationOption = Annotated[
    float | None, typer.Option("--modulation-hz", help="Modulation frequency of a pcap or bag.")
]
AmplitudeOption = Annotated[str, typer.Option("--amplitude-topic", help="Of a bag.")]
DistanceOption = Annotated[str | None, typer.Option("--distance-topic", help="Of a bag.")]
OutOption = Annotated[
    Path, typer.Option("--out", "-o", help="Folder for recordings and snapshots.")
]
HostOption = Annotated[str, typer.Option("--host", help="Address to listen at.")]
PortOption = Annotated[
    int, typer.Option("--port", min=0, max=65535, help="Port to listen at; 0: a free one.")
]
RemoteOption = Annotated[
    bool, typer.Option("--allow-remote", help="Let other computers in, without encryption.")
]
OpenOption = Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")]
SecondsOption = Annotated[float | None, typer.Option("--seconds", min=0.0, help="End by itself.")]


def live(
    rig: RigOption = None,
    replay: ReplayOption = None,
    simulate: SimulateOption = None,
    pattern: PatternOption = "square",
    scale: ScaleOption = 2,
    method: MethodOption = "auto",
    blur_px: BlurOption = None,
    rate_hz: RateOption = 25.0,
    calibration: CalibrationOption = None,
    pitch_mm: PitchOption = "0.155",
    modulation_hz: ModulationOption = None,
    amplitude_topic: AmplitudeOption = "",
    distance_topic: DistanceOption = None,
    out: OutOption = Path("live"),
    host: HostOption = "127.0.0.1",
    port: PortOption = 8765,
    allow_remote: RemoteOption = False,
    open_page: OpenOption = True,
    seconds: SecondsOption = None,
    yes: YesOption = False,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Show a picture after each frame in a browser, with the point cloud and the MTF of an edge.

    Only this computer can open the page, and only by the whole address that is printed. Ctrl-C
    ends it; the lens goes back to rest.

    \b
    Examples:
      lensshift live --rig emulated
      lensshift live --rig rig.toml --calibration calibration.json
      lensshift live --replay burst.nc --scale 3
      lensshift live --replay recording.pcap --modulation-hz 15e6
      lensshift live --simulate slanted_edge --pattern 3x3
    """
    with session(as_json=as_json, debug=debug) as current:
        from lensshift.live.controls import checked
        from lensshift.live.picture import Settings
        from lensshift.live.serve import is_loopback, listening, require_web

        given = [one for one in (rig, replay, simulate) if one is not None]
        if len(given) != 1:
            raise typer.BadParameter("expected one of --rig, --replay and --simulate")
        if not (is_loopback(host) or allow_remote):
            raise typer.BadParameter(
                f"other computers could reach {host}; --allow-remote says that they may"
            )
        require_web()
        _check_pattern(pattern)
        settings = checked(Settings(scale, method, blur_px))
        if rig is not None:
            source = _rig(rig, pattern, calibration, yes=yes)
        elif replay is not None:
            camera = {
                "pitch_mm": parse_pitch_mm(pitch_mm),
                "modulation_hz": modulation_hz,
                "amplitude_topic": amplitude_topic,
                "distance_topic": distance_topic,
            }
            source = _replay(replay, pattern, rate_hz, camera)
        else:
            source = _simulated(str(simulate), pattern, rate_hz)
        with listening(host, port) as listener, source as frames:
            _show(current, frames, settings, (listener, out, seconds, debug), open_page=open_page)


def _show(
    current: Session, frames: Source, settings: Any, where: tuple[Any, ...], *, open_page: bool
) -> None:
    from lensshift.core.errors import DeviceError
    from lensshift.live.serve import serve
    from lensshift.live.sources import RigSource
    from lensshift.live.worker import Live

    listener, out, seconds, debug = where

    def ready(address: str) -> None:
        current.result |= {"address": address, "source": frames.name}
        current.ready()
        current.say(f"{frames.name}\nopen {address}\nCtrl-C ends it.")
        if open_page:
            import webbrowser

            webbrowser.open(address)

    with Live(frames, settings) as running:
        # One a picture is too many for a terminal: the page shows the latest.
        warnings.showwarning = lambda message, *_, **__: running.warn(str(message))
        try:
            serve(running, listener, out, seconds=seconds, debug=debug, on_ready=ready)
        except KeyboardInterrupt:  # the way out, not a failure
            current.say("ending; the lens goes to rest")
    pictures = 0 if running.picture is None else running.picture.number
    current.result |= {"frames": running.frame_count, "pictures": pictures}
    current.say(f"{running.frame_count} frames, {pictures} pictures")
    if running.problem and isinstance(frames, RigSource):
        raise DeviceError(running.problem)


def _check_pattern(pattern: str) -> None:
    from lensshift.capture.plan import PLANS

    if pattern not in PLANS:
        raise typer.BadParameter(f"expected a plan of {', '.join(PLANS)}, got {pattern!r}")


@contextmanager
def _rig(rig: str, pattern: str, calibration: Path | None, *, yes: bool) -> Iterator[Source]:
    from lensshift.live.sources import RigSource

    if rig == "emulated":
        from lensshift.live.emulated import emulated_rig

        opening = emulated_rig()
    else:
        from lensshift.capture.opening import open_rig

        opening = open_rig(rig, on_homing=homing_asked(yes=yes))  # type: ignore[assignment]
    with opening as opened:
        if calibration is not None:
            from lensshift.io.calibration_file import load_calibration

            opened.calibration = load_calibration(calibration)
        yield RigSource(opened, pattern)


@contextmanager
def _replay(path: Path, pattern: str, rate_hz: float, camera: dict[str, Any]) -> Iterator[Source]:
    from lensshift.io import load_burst
    from lensshift.io.capture_file import is_capture
    from lensshift.io.container_reader import is_hdf5
    from lensshift.live.sources import BurstSource, CameraSource

    if not path.exists():
        raise typer.BadParameter(f"there is no {path}")
    if path.is_file() and (is_hdf5(path) or is_capture(path)):
        yield BurstSource(load_burst(path), path.name, rate_hz=rate_hz)
        return
    yield CameraSource(_camera(path, camera), pattern)


def _camera(path: Path, settings: dict[str, Any]) -> ReplayCamera:
    from lensshift.capture.drivers.replay import ReplayCamera

    return ReplayCamera(path, **settings)


@contextmanager
def _simulated(name: str, pattern: str, rate_hz: float) -> Iterator[Source]:
    from lensshift.live.sources import SimulatedSource
    from lensshift.pipeline.experiment_file import SCENES, default_experiment, load_experiment

    if name in SCENES:
        scene, experiment = SCENES[name](), default_experiment()
    else:
        experiment = load_experiment(name)
        scene = experiment.scene
    if not math.isfinite(rate_hz):
        raise typer.BadParameter("expected a finite --rate-hz")
    yield SimulatedSource(
        scene,
        experiment.camera,
        pattern,
        rate_hz=rate_hz,
        shift_error_px=experiment.shift_error_px,
        seed=experiment.seed,
    )
