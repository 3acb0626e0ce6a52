"""A whole rig that is not there: stages and camera over the real protocols, one world behind."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from lensshift.camera import RunningCamera, TofCamera, camera_preset
from lensshift.camera.moving import REACH_PX
from lensshift.capture.drivers.apt_settings import AptSettings
from lensshift.capture.emulators.apt import EmulatedStagePair
from lensshift.capture.emulators.o3m import O3MSender
from lensshift.capture.opening import QUARTER_PIXEL_MM
from lensshift.core.arrays import Array
from lensshift.core.types import Frame
from lensshift.scene import Scene, four_boxes

_INSTANTS = 4  # of the lens during an exposure
_STILL_MM = 1e-6  # less is rounding
_HOMING_S = 12.0  # the longest move of a real stage: 7.3 mm at 1 mm/s, and its ramps


def _turned() -> Array:
    """Return image shift over lens travel of stages half a degree turned, one of them 2 % off."""
    per_mm = 0.25 / QUARTER_PIXEL_MM
    turn = np.deg2rad(0.5)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return np.asarray(rotation @ np.diag([per_mm, 1.02 * per_mm]))


@dataclass(frozen=True, slots=True, eq=False)
class RigSettings:
    """What an emulated rig is like; `rest_mm` [2] is the lens position of no shift."""

    scene: Scene = field(default_factory=four_boxes)
    camera: TofCamera = field(default_factory=lambda: camera_preset("o3m151"))
    px_per_mm: Array = field(default_factory=_turned)  # [2 2] in the middle of the sensor
    field_share: float = 0.02  # how much more the image shifts at the ends of the sensor
    rest_mm: Array = field(default_factory=lambda: np.array([3.0, 3.0]))
    play_mm: float = 0.006  # of the stages
    encoder_noise_mm: float = 0.001  # of the stages
    message_loss: float = 0.02  # share of the messages of the stages that lose a byte
    packet_loss: float = 0.01  # share of the packets of the camera
    reorder: float = 0.01
    drift_px_per_s: tuple[float, float] = (0.0, 0.0)  # [2] of the image while the lens stands still
    brightness_jump: float = 0.0  # share by which every other frame may be brighter, untold
    rate_hz: float = 25.0  # frames per second
    speed: float = 1.0  # of the stages, times their own
    seed: int = 0  # of all of it


class EmulatedWorld:
    """The scene as the camera sees it through the lens, which is at `lens_mm` [2] at an instant."""

    def __init__(self, settings: RigSettings, lens_mm: Any) -> None:
        self._settings, self._lens_mm = settings, lens_mm
        self._rng = np.random.default_rng(settings.seed)
        self._began_s = time.monotonic()
        self.running = RunningCamera(settings.scene, settings.camera)
        rows, cols = (np.linspace(-1.0, 1.0, count) for count in settings.camera.grid.shape)
        radius = np.hypot(*np.meshgrid(rows * len(rows) / len(cols), cols, indexing="ij"))
        self._share = (1.0 + settings.field_share * radius**2)[..., None]
        self.running.frame([[0.0, 0.0]], np.random.default_rng(0))  # compile before the first one

    def offset_px(self, lens_mm: Array) -> Array:
        """Return the true image offset [row col 2] for a lens position [2]."""
        middle = self._settings.px_per_mm @ (lens_mm - self._settings.rest_mm)
        return np.asarray(self._share * middle)

    def look(self, begin_s: float, end_s: float) -> Frame:
        """Expose a frame while the lens does what it did then."""
        instants = np.linspace(begin_s, end_s, _INSTANTS)
        places = np.stack([self._lens_mm(float(instant)) for instant in instants])
        if np.ptp(places, axis=0).max() < _STILL_MM:
            places = places[:1]
        # Far from rest, as on the way home, the image has left the scene that was cast.
        drift_px = np.asarray(self._settings.drift_px_per_s) * (end_s - self._began_s)
        away_px = [self.offset_px(place) + drift_px for place in places]
        offsets = [np.clip(one, -REACH_PX, REACH_PX) for one in away_px]
        image = self.running.frame(np.stack(offsets), self._rng)
        gain = 1.0 + self._settings.brightness_jump * self._rng.integers(2)
        return Frame(image.amplitude * gain, image.distance_m, image.valid, end_s)


class EmulatedRig:
    """Two APT controllers on loopback TCP and an O3M that sends by UDP, for a `with` block."""

    def __init__(self, settings: RigSettings | None = None, *, camera_port: int) -> None:
        self.settings = settings or RigSettings()
        one = self.settings
        self.stages = EmulatedStagePair(
            play_mm=one.play_mm, encoder_noise_mm=one.encoder_noise_mm, loss=one.message_loss,
            speed=one.speed, seed=one.seed,
        )  # fmt: skip
        self.world = EmulatedWorld(one, self.stages.lens_mm)
        self.camera = O3MSender(
            self.world.look, rate_hz=one.rate_hz, port=camera_port, loss=one.packet_loss,
            reorder=one.reorder, seed=one.seed,
        )  # fmt: skip
        self._port = camera_port
        self._open = ExitStack()

    def rig_file(self) -> str:
        """Return the rig file (TOML) of the running devices, with what a designer expects."""
        one = self.settings
        row, col = self.stages.urls
        rest = ", ".join(f"{x:g}" for x in one.rest_mm)
        return (
            f'[stage]\nrow = "{row}"\ncol = "{col}"\n'
            'home = "if_needed"  # nothing real moves\n'
            f"enable_wait_s = {AptSettings().enable_wait_s / one.speed:g}\n"
            f"timeout_margin_s = {10.0 + _HOMING_S / min(one.speed, 1.0):g}"
            "  # this computer emulates as well\n"
            f"tolerance_mm = {max(0.001, 5.0 * one.encoder_noise_mm):g}\n\n"
            f'[camera]\nkind = "o3m"\nport = {self._port}\nhost = "127.0.0.1"\n'
            f"modulation_hz = {one.camera.illumination.modulation_hz[0]:g}\n\n"
            f"[calibration]\nrest_mm = [{rest}]\n\n"
            f"[acquisition]\nhold_mm = {max(0.005, 5.0 * one.encoder_noise_mm):g}\n"
        )

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            opening.enter_context(self.stages)
            opening.enter_context(self.camera)
            self._open = opening.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()
