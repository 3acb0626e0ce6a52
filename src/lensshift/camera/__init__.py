"""What the world does to an image before anybody can estimate anything from it.

Two cameras that share no code with `lensshift.forward`: `simulate_burst` takes flat targets with
plain pixels, `simulate_tof` a scene in the world with a time-of-flight camera, effect by effect.
"""

from lensshift.camera.flat import QUARTER_SQUARE_PX, Sensor, Truth, pixel_means, simulate_burst
from lensshift.camera.moving import RunningCamera
from lensshift.camera.output import O3mImages
from lensshift.camera.presets import camera_preset, preset_names
from lensshift.camera.settings import (
    Ambient,
    Drift,
    Illumination,
    LensOptics,
    Multipath,
    Pixels,
    PlainOptics,
    Readout,
    Scatter,
    TofCamera,
    Validity,
)
from lensshift.camera.simulate import (
    RawPhases,
    TofCapture,
    TofTruth,
    simulate_tof,
    simulate_tof_burst,
)
from lensshift.core.pattern import PATTERNS, grid_pattern_px, named_pattern_px

__all__ = [
    "PATTERNS",
    "QUARTER_SQUARE_PX",
    "Ambient",
    "Drift",
    "Illumination",
    "LensOptics",
    "Multipath",
    "O3mImages",
    "Pixels",
    "PlainOptics",
    "RawPhases",
    "Readout",
    "RunningCamera",
    "Scatter",
    "Sensor",
    "TofCamera",
    "TofCapture",
    "TofTruth",
    "Truth",
    "Validity",
    "camera_preset",
    "grid_pattern_px",
    "named_pattern_px",
    "pixel_means",
    "preset_names",
    "simulate_burst",
    "simulate_tof",
    "simulate_tof_burst",
]
