"""`lensshift emulate`: devices that are not there, for a rig of one's own in another window."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lensshift.cli.session import Session, picked
from lensshift.cli.verbs import option, verb, verb_group

if TYPE_CHECKING:
    from lensshift.capture.emulators.rig import EmulatedWorld

emulate = verb_group(
    help="Emulate devices over their real protocols until Ctrl-C, on this computer only."
)

JsonOption = Annotated[
    bool,
    typer.Option("--json", help="Print ports as a line of JSON when ready, the result at the end."),
]
SceneOption = Annotated[str, typer.Option(help="Name of a scene, or a scene file (TOML).")]
PortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="UDP port of the camera; 0: a free one.")
]
RateOption = Annotated[float, typer.Option("--rate-hz", min=0.1, help="Frames per second.")]
SpeedOption = Annotated[float, typer.Option(min=0.1, help="Of the stages, times their own.")]
PlayOption = Annotated[float, typer.Option("--play-um", min=0.0, help="Play of the stages.")]
NoiseOption = Annotated[float, typer.Option("--noise-um", min=0.0, help="Noise of the encoders.")]
StageLossOption = Annotated[
    float, typer.Option("--message-loss", min=0.0, max=0.5, help="Share of damaged stage messages.")
]
PacketLossOption = Annotated[
    float, typer.Option("--packet-loss", min=0.0, max=0.9, help="Share of lost camera packets.")
]
ReorderOption = Annotated[float, typer.Option(min=0.0, max=0.9, help="Share of swapped packets.")]


@dataclass(frozen=True, slots=True)
class Course:
    """How long an emulator runs, and what its chance is."""

    seconds: float | None = option(None, "End by itself.", min=0.0)
    seed: int = option(0, "Of noise and faults.", min=0)


@dataclass(frozen=True, slots=True)
class _CameraOptions:
    scene: SceneOption = "four_boxes"
    port: PortOption = 42000
    rate_hz: RateOption = 25.0
    course: Course = Course()


@dataclass(frozen=True, slots=True)
class _RigOptions(_CameraOptions):
    file: Path | None = option(None, "Write the rig file for `lensshift capture`.")
    speed: SpeedOption = 1.0
    play_um: PlayOption = 6.0
    noise_um: NoiseOption = 1.0
    message_loss: StageLossOption = 0.02
    packet_loss: PacketLossOption = 0.01
    reorder: ReorderOption = 0.01


@emulate.command()
@verb(json=JsonOption)
def rig(current: Session, asked: _RigOptions) -> None:
    """Emulate both stages and an O3M whose image moves with them.

    \b
    Example:
      lensshift emulate rig --file rig.toml &
      lensshift capture rig.toml -o burst.nc
    """
    from lensshift.capture.emulators.listener import free_udp_port
    from lensshift.capture.emulators.rig import EmulatedRig, RigSettings
    from lensshift.core.atomic import write_text
    from lensshift.pipeline.experiment_file import named_scene

    settings = RigSettings(
        scene=named_scene(asked.scene), play_mm=1e-3 * asked.play_um,
        encoder_noise_mm=1e-3 * asked.noise_um, seed=asked.course.seed,
        **picked(asked, "message_loss packet_loss reorder rate_hz speed"),
    )  # fmt: skip
    port = asked.port or free_udp_port()
    with EmulatedRig(settings, camera_port=port) as running:
        text = running.rig_file()
        if asked.file is not None:
            write_text(asked.file, text)
            current.say(f"wrote {asked.file}")
        current.say(text)
        current.result |= {"stage": list(running.stages.urls), "camera_port": port}
        _until_stopped(asked.course, lambda: {"sent": running.camera.sent}, current)


@dataclass(frozen=True, slots=True)
class _StageOptions:
    link: str = option("tcp", "tcp, or pty (not on Windows).")
    speed: SpeedOption = 1.0
    play_um: PlayOption = 6.0
    noise_um: NoiseOption = 0.0
    loss: StageLossOption = 0.0
    course: Course = Course()


@emulate.command()
@verb(json=JsonOption)
def stage(current: Session, asked: _StageOptions) -> None:
    """Emulate a pair of APT controllers (TDC001 and KDC101) with Z806 actuators.

    \b
    Example:
      lensshift emulate stage --link pty --play-um 6
    """
    from lensshift.capture.emulators.apt import EmulatedStagePair

    if asked.link not in ("tcp", "pty"):
        raise typer.BadParameter(f"expected tcp or pty, got {asked.link!r}")
    with EmulatedStagePair(
        play_mm=1e-3 * asked.play_um, encoder_noise_mm=1e-3 * asked.noise_um, loss=asked.loss,
        speed=asked.speed, seed=asked.course.seed, link="pty" if asked.link == "pty" else "tcp",
    ) as pair:  # fmt: skip
        for axis, url in zip(("row", "col"), pair.urls, strict=True):
            current.say(f'{axis} = "{url}"')
        current.result |= {"stage": list(pair.urls)}
        _until_stopped(asked.course, dict, current)


@dataclass(frozen=True, slots=True)
class _O3mOptions(_CameraOptions):
    layout: str = option("1.4", "Of the pixel data, 1.0 to 1.4.")
    packet_loss: PacketLossOption = 0.0
    reorder: ReorderOption = 0.0


@emulate.command()
@verb(json=JsonOption)
def o3m(current: Session, asked: _O3mOptions) -> None:
    """Emulate an O3M that sends frames of a scene by UDP; its lens stands still.

    \b
    Example:
      lensshift emulate o3m --rate-hz 50 --packet-loss 0.01
    """
    from lensshift.capture.emulators.listener import free_udp_port
    from lensshift.capture.emulators.o3m import O3MSender

    port = asked.port or free_udp_port()
    with O3MSender(
        _still_world(asked.scene, asked.course.seed).look, port=port, loss=asked.packet_loss,
        seed=asked.course.seed, **picked(asked, "rate_hz layout reorder"),
    ) as sender:  # fmt: skip
        current.say(f"O3M, layout {asked.layout}, sends to UDP port {port} at {asked.rate_hz:g} Hz")
        current.result |= {"camera_port": port}
        _until_stopped(asked.course, lambda: {"sent": sender.sent}, current)


@dataclass(frozen=True, slots=True)
class _PcicOptions(_CameraOptions):
    port: int = option(50010, "TCP port; 0: a free one.", min=0, max=65535)
    rate_hz: RateOption = 10.0
    model: str = option("O3D", "O3D or O3R.")
    xmlrpc_port: int = option(
        0, "TCP port of its settings, 80 of a real one; 0: a free one.", min=0, max=65535
    )


@emulate.command()
@verb(json=JsonOption)
def pcic(current: Session, asked: _PcicOptions) -> None:
    """Emulate a camera that streams frames of a scene by PCIC over TCP.

    Clients such as ifm3d first ask what it is, by XML-RPC at another port.

    \b
    Example:
      lensshift emulate pcic --model O3R --port 50010 --xmlrpc-port 8080
    """
    from lensshift.capture.emulators.ifm_device import IfmDevice
    from lensshift.capture.emulators.pcic import PcicServer

    look, model = _still_world(asked.scene, asked.course.seed).look, asked.model
    with (
        PcicServer(look, port=asked.port, rate_hz=asked.rate_hz, model=model) as server,
        IfmDevice(model, server.port, port=asked.xmlrpc_port) as device,
    ):
        current.say(f"{model} answers at 127.0.0.1:{server.port}, {asked.rate_hz:g} Hz")
        current.say(f"its settings at port {device.port} (XML-RPC)")
        current.result |= {"camera_port": server.port, "xmlrpc_port": device.port}
        _until_stopped(asked.course, lambda: {"sent": server.sent}, current)


def _still_world(scene: str, seed: int) -> EmulatedWorld:
    from lensshift.capture.emulators.rig import EmulatedWorld, RigSettings
    from lensshift.pipeline.experiment_file import named_scene

    settings = RigSettings(scene=named_scene(scene), seed=seed)
    return EmulatedWorld(settings, lambda _: settings.rest_mm)


def _until_stopped(course: Course, counts: Callable[[], dict[str, int]], current: Session) -> None:
    """Wait for Ctrl-C, or so long; then say what was sent."""
    current.say_json(current.result, indent=None)  # for who waits for it
    end_s = time.monotonic() + (math.inf if course.seconds is None else course.seconds)
    with suppress(KeyboardInterrupt):  # here it is the way out, not a failure
        if course.seconds is None:
            current.say("Ctrl-C ends it.")
        while (left_s := end_s - time.monotonic()) > 0.0:
            time.sleep(min(0.1, left_s))
    current.result |= counts()
    for name, count in counts().items():
        current.say(f"{name} {count} frames")
