"""`lensshift emulate`: devices that are not there, for a rig of one's own in another window."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensshift.cli.session import DebugOption, Session, session
from lensshift.cli.verbs import verb_group

if TYPE_CHECKING:
    from lensshift.capture.emulators.rig import EmulatedWorld

emulate = verb_group(
    help="Emulate devices over their real protocols until Ctrl-C, on this computer only.",
)

JsonOption = Annotated[
    bool,
    typer.Option("--json", help="Print ports as a line of JSON when ready, the result at the end."),
]
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
RateOption = Annotated[float, typer.Option("--rate-hz", min=0.1, help="Frames per second.")]
PortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="UDP port of the camera; 0: a free one.")
]
SceneOption = Annotated[str, typer.Option(help="Name of a scene, or a scene file (TOML).")]
SecondsOption = Annotated[float | None, typer.Option(min=0.0, help="End by itself.")]
SeedOption = Annotated[int, typer.Option(min=0, help="Of noise and faults.")]


@emulate.command()
def rig(
    file: Annotated[
        Path | None, typer.Option("--file", help="Write the rig file for `lensshift capture`.")
    ] = None,
    scene: SceneOption = "four_boxes",
    port: PortOption = 42000,
    rate_hz: RateOption = 25.0,
    speed: SpeedOption = 1.0,
    play_um: PlayOption = 6.0,
    noise_um: NoiseOption = 1.0,
    message_loss: StageLossOption = 0.02,
    packet_loss: PacketLossOption = 0.01,
    reorder: ReorderOption = 0.01,
    seconds: SecondsOption = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Emulate both stages and an O3M whose image moves with them.

    \b
    Example:
      lensshift emulate rig --file rig.toml &
      lensshift capture rig.toml -o burst.nc
    """
    with session(as_json=as_json, debug=debug) as current:
        from lensshift.capture.emulators.listener import free_udp_port
        from lensshift.capture.emulators.rig import EmulatedRig, RigSettings

        settings = RigSettings(
            scene=_scene(scene),
            play_mm=1e-3 * play_um,
            encoder_noise_mm=1e-3 * noise_um,
            message_loss=message_loss,
            packet_loss=packet_loss,
            reorder=reorder,
            rate_hz=rate_hz,
            speed=speed,
            seed=seed,
        )
        port = port or free_udp_port()
        with EmulatedRig(settings, camera_port=port) as running:
            text = running.rig_file()
            if file is not None:
                _write(file, text)
                current.say(f"wrote {file}")
            current.say(text)
            current.result |= {"stage": list(running.stages.urls), "camera_port": port}
            _until_stopped(seconds, lambda: {"sent": running.camera.sent}, current)


@emulate.command()
def stage(
    link: Annotated[str, typer.Option(help="tcp, or pty (not on Windows).")] = "tcp",
    speed: SpeedOption = 1.0,
    play_um: PlayOption = 6.0,
    noise_um: NoiseOption = 0.0,
    loss: StageLossOption = 0.0,
    seconds: SecondsOption = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Emulate a pair of APT controllers (TDC001 and KDC101) with Z806 actuators.

    \b
    Example:
      lensshift emulate stage --link pty --play-um 6
    """
    with session(as_json=as_json, debug=debug) as current:
        from lensshift.capture.emulators.apt import EmulatedStagePair

        if link not in ("tcp", "pty"):
            raise typer.BadParameter(f"expected tcp or pty, got {link!r}")
        with EmulatedStagePair(
            play_mm=1e-3 * play_um,
            encoder_noise_mm=1e-3 * noise_um,
            loss=loss,
            speed=speed,
            seed=seed,
            link="pty" if link == "pty" else "tcp",
        ) as pair:
            for axis, url in zip(("row", "col"), pair.urls, strict=True):
                current.say(f'{axis} = "{url}"')
            current.result |= {"stage": list(pair.urls)}
            _until_stopped(seconds, dict, current)


@emulate.command()
def o3m(
    scene: SceneOption = "four_boxes",
    port: PortOption = 42000,
    rate_hz: RateOption = 25.0,
    layout: Annotated[str, typer.Option(help="Of the pixel data, 1.0 to 1.4.")] = "1.4",
    packet_loss: PacketLossOption = 0.0,
    reorder: ReorderOption = 0.0,
    seconds: SecondsOption = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Emulate an O3M that sends frames of a scene by UDP; its lens stands still.

    \b
    Example:
      lensshift emulate o3m --rate-hz 50 --packet-loss 0.01
    """
    with session(as_json=as_json, debug=debug) as current:
        from lensshift.capture.emulators.listener import free_udp_port
        from lensshift.capture.emulators.o3m import O3MSender

        port = port or free_udp_port()
        with O3MSender(
            _still_world(scene, seed).look,
            port=port,
            rate_hz=rate_hz,
            layout=layout,
            loss=packet_loss,
            reorder=reorder,
            seed=seed,
        ) as sender:
            current.say(f"O3M, layout {layout}, sends to UDP port {port} at {rate_hz:g} Hz")
            current.result |= {"camera_port": port}
            _until_stopped(seconds, lambda: {"sent": sender.sent}, current)


@emulate.command()
def pcic(
    scene: SceneOption = "four_boxes",
    port: Annotated[int, typer.Option(min=0, max=65535, help="TCP port; 0: a free one.")] = 50010,
    rate_hz: RateOption = 10.0,
    model: Annotated[str, typer.Option(help="O3D or O3R.")] = "O3D",
    xmlrpc_port: Annotated[
        int,
        typer.Option(
            "--xmlrpc-port",
            min=0,
            max=65535,
            help="TCP port of its settings, 80 of a real one; 0: a free one.",
        ),
    ] = 0,
    seconds: SecondsOption = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Emulate a camera that streams frames of a scene by PCIC over TCP.

    Clients such as ifm3d first ask what it is, by XML-RPC at another port.

    \b
    Example:
      lensshift emulate pcic --model O3R --port 50010 --xmlrpc-port 8080
    """
    with session(as_json=as_json, debug=debug) as current:
        from lensshift.capture.emulators.ifm_device import IfmDevice
        from lensshift.capture.emulators.pcic import PcicServer

        look = _still_world(scene, seed).look
        with (
            PcicServer(look, port=port, rate_hz=rate_hz, model=model) as server,
            IfmDevice(model, server.port, port=xmlrpc_port) as device,
        ):
            current.say(f"{model} answers at 127.0.0.1:{server.port}, {rate_hz:g} Hz")
            current.say(f"its settings at port {device.port} (XML-RPC)")
            current.result |= {"camera_port": server.port, "xmlrpc_port": device.port}
            _until_stopped(seconds, lambda: {"sent": server.sent}, current)


def _scene(name: str) -> Any:
    from lensshift.pipeline.experiment_file import named_scene

    return named_scene(name)


def _still_world(scene: str, seed: int) -> EmulatedWorld:
    from lensshift.capture.emulators.rig import EmulatedWorld, RigSettings

    settings = RigSettings(scene=_scene(scene), seed=seed)
    return EmulatedWorld(settings, lambda _: settings.rest_mm)


def _write(file: Path, text: str) -> None:
    from lensshift.io.atomic import written_whole

    with written_whole(file) as part:
        part.write_text(text, encoding="utf-8")


def _until_stopped(
    seconds: float | None, counts: Callable[[], dict[str, int]], current: Session
) -> None:
    """Wait for Ctrl-C, or so long; then say what was sent."""
    current.ready()
    with _interruptible():
        end_s = None if seconds is None else time.monotonic() + seconds
        if seconds is None:
            current.say("Ctrl-C ends it.")
        while end_s is None or time.monotonic() < end_s:
            time.sleep(0.1 if end_s is None else min(0.1, max(0.0, end_s - time.monotonic())))
    current.result |= counts()
    for name, count in counts().items():
        current.say(f"{name} {count} frames")


@contextmanager
def _interruptible() -> Iterator[None]:
    """Let Ctrl-C end the block: here it is the way out, not a failure."""
    try:
        yield
    except KeyboardInterrupt:
        return
