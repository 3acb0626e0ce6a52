"""`lensshift live`: pictures as the frames come, in a browser."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lensshift.cli.devices import YesOption, homing_asked
from lensshift.cli.inputs import parse_pitch_mm
from lensshift.cli.session import Session, picked
from lensshift.cli.verbs import option, verb

if TYPE_CHECKING:
    from socket import socket

    from lensshift.live.picture import Settings
    from lensshift.live.sources import Source


@dataclass(frozen=True, slots=True)
class _LiveOptions:
    rig: str | None = option(None, "Rig file (TOML), or: emulated.")
    replay: Path | None = option(None, "Burst file, capture, pcap, pcapng or ROS bag.")
    simulate: str | None = option(None, "Scene by name, scene or experiment file (TOML).")
    pattern: str = option("square", "square, 3x3, 4x4, quincunx, spiral or still.")
    scale: int = option(2, "HR pixels per pixel.", min=1, max=8)
    method: str = option("auto", "As of `reconstruct`.")
    blur_px: float | None = option(
        None, "Width of the pixel response; else what is known.", min=0.0
    )
    rate_hz: float = option(25.0, "Frames a second of --simulate and bursts.", min=0.1)
    calibration: Path | None = option(None, "From `calibrate`; instead of the rig file's.")
    pitch_mm: str = option("0.155", "Pixel pitch of a pcap or bag: one number, or row,col.")
    modulation_hz: float | None = option(None, "Modulation frequency of a pcap or bag.")
    amplitude_topic: str = option("", "Of a bag.")
    distance_topic: str | None = option(None, "Of a bag.")
    out: Path = option(Path("live"), "Folder for recordings and snapshots.", "-o")
    host: str = option("127.0.0.1", "Address to listen at.")
    port: int = option(8765, "Port to listen at; 0: a free one.", min=0, max=65535)
    allow_remote: bool = option(False, "Let other computers in, without encryption.")
    open_page: bool = option(True, "Open the page in a browser.", "--open/--no-open")
    seconds: float | None = option(None, "End by itself.", min=0.0)
    yes: YesOption = False


@verb()
def live(current: Session, asked: _LiveOptions) -> None:
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
    from lensshift.capture.plan import PLANS
    from lensshift.live.controls import checked
    from lensshift.live.picture import Settings
    from lensshift.live.serve import is_loopback, listening, require_web

    given = [one for one in (asked.rig, asked.replay, asked.simulate) if one is not None]
    if len(given) != 1:
        raise typer.BadParameter("expected one of --rig, --replay and --simulate")
    if not (is_loopback(asked.host) or asked.allow_remote):
        raise typer.BadParameter(
            f"other computers could reach {asked.host}; --allow-remote says that they may"
        )
    require_web()
    if asked.pattern not in PLANS:
        expected = ", ".join(PLANS)
        raise typer.BadParameter(f"expected a plan of {expected}, got {asked.pattern!r}")
    settings = checked(Settings(asked.scale, asked.method, asked.blur_px))
    with listening(asked.host, asked.port) as listener, _source(asked) as frames:
        _show(current, asked, frames, settings, listener)


def _show(
    current: Session, asked: _LiveOptions, frames: Source, settings: Settings, listener: socket
) -> None:
    from lensshift.core.errors import DeviceError
    from lensshift.live.serve import serve
    from lensshift.live.sources import RigSource
    from lensshift.live.worker import Live

    def ready(address: str) -> None:
        current.result |= {"address": address, "source": frames.name}
        current.say_json(current.result, indent=None)  # for who waits for it
        current.say(f"{frames.name}\nopen {address}\nCtrl-C ends it.")
        if asked.open_page:
            import webbrowser

            webbrowser.open(address)

    with Live(frames, settings) as running:
        # One a picture is too many for a terminal: the page shows the latest.
        warnings.showwarning = lambda message, *_, **__: running.warn(str(message))
        try:
            serve(
                running, listener, asked.out, seconds=asked.seconds, debug=current.debug,
                on_ready=ready,
            )  # fmt: skip
        except KeyboardInterrupt:  # the way out, not a failure
            current.say("ending; the lens goes to rest")
    pictures = 0 if running.picture is None else running.picture.number
    current.result |= {"frames": running.frame_count, "pictures": pictures}
    current.say(f"{running.frame_count} frames, {pictures} pictures")
    if running.problem and (isinstance(frames, RigSource) or not running.frame_count):
        raise DeviceError(running.problem)


def _source(asked: _LiveOptions) -> AbstractContextManager[Source]:
    if asked.rig is not None:
        return _rig(asked.rig, asked)
    if asked.replay is not None:
        return nullcontext(_replay(asked.replay, asked))
    return nullcontext(_simulated(str(asked.simulate), asked))


@contextmanager
def _rig(rig: str, asked: _LiveOptions) -> Iterator[Source]:
    from lensshift.capture.opening import open_rig
    from lensshift.live.sources import RigSource

    if rig == "emulated":
        from lensshift.live.emulated import emulated_rig

        opening = emulated_rig()
    else:
        opening = open_rig(rig, on_homing=homing_asked(yes=asked.yes))  # type: ignore[assignment]
    with opening as opened:
        if asked.calibration is not None:
            from lensshift.io.calibration_file import load_calibration

            opened.calibration = load_calibration(asked.calibration)
        yield RigSource(opened, asked.pattern)


def _replay(path: Path, asked: _LiveOptions) -> Source:
    from lensshift.capture.drivers.replay import ReplayCamera
    from lensshift.io import load_burst
    from lensshift.io.capture_file import is_capture
    from lensshift.io.container_reader import is_hdf5
    from lensshift.io.image_file import IMAGE_SUFFIXES
    from lensshift.live.sources import BurstSource, CameraSource

    pitch_mm = parse_pitch_mm(asked.pitch_mm)
    if not path.exists():
        raise typer.BadParameter(f"there is no {path}")
    if path.is_file() and (is_hdf5(path) or is_capture(path)):
        return BurstSource(load_burst(path), path.name, rate_hz=asked.rate_hz)
    if path.suffix.lower() in (*IMAGE_SUFFIXES, ".npz"):
        raise typer.BadParameter(
            f"{path} is no recording; make it one: lensshift convert {path} burst.nc --offsets CSV"
        )
    told = picked(asked, "modulation_hz amplitude_topic distance_topic")
    camera = ReplayCamera(path, pitch_mm=pitch_mm, **told)
    return CameraSource(camera, asked.pattern)


def _simulated(name: str, asked: _LiveOptions) -> Source:
    from lensshift.live.sources import SimulatedSource
    from lensshift.pipeline.experiment_file import SCENES, default_experiment, load_experiment

    if name in SCENES:
        scene, experiment = SCENES[name](), default_experiment()
    else:
        experiment = load_experiment(name)
        scene = experiment.scene
    if not math.isfinite(asked.rate_hz):
        raise typer.BadParameter("expected a finite --rate-hz")
    told = picked(experiment, "shift_error_px seed") | {"rate_hz": asked.rate_hz}
    return SimulatedSource(scene, experiment.camera, asked.pattern, **told)
