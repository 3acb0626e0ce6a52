"""Small cameras with long lenses and plain worlds whose images are known in closed form."""

from collections.abc import Callable
from typing import Any

import numpy as np

from lensshift.camera import (
    Illumination,
    PlainOptics,
    Readout,
    TofCamera,
    simulate_tof,
)
from lensshift.core.grid import Grid
from lensshift.scene import Plane, Rectangle, Scene

FOCAL_MM = 2000.0  # the field is so narrow that distances and angles are those on the axis
ODD = Grid((9, 13), (0.1, 0.2))
EXACT = {"shift_error_px": 0.0}
HZ = 15e6
LIGHT_MPS = 299_792_458.0


def make_camera(grid: Grid = ODD, **groups: Any) -> TofCamera:
    """Return a camera without noise and errors, but with the groups given."""
    settings: dict[str, Any] = {
        "optics": PlainOptics(focal_length_mm=FOCAL_MM, f_number=2.0),
        "illumination": Illumination((HZ,)),
        "readout": quiet(),
    }
    return TofCamera(grid=grid, **(settings | groups))


def quiet(**changes: Any) -> Readout:
    """Return a readout without noise, full well and converter, but with the changes given."""
    settings: dict[str, Any] = {
        "saturates": False, "shot_noise": False, "read_noise_electrons": 0.0, "bits": None,
    }  # fmt: skip
    return Readout(**(settings | changes))


def wall(distance_m: float = 3.5, reflectance: Any = 0.5, **pose: Any) -> Scene:
    """Return an endless wall across the axis."""
    return Scene((Plane(centre_m=(0.0, 0.0, distance_m), reflectance=reflectance, **pose),))


def stripes(per_px: float, distance_m: float, grid: Grid = ODD, *, down: bool = False) -> Callable:
    """Return a texture 0.6 + 0.3 cos, with cycles per pixel along columns (or rows)."""
    pitch_m = 1e-3 * grid.pitch_mm[0 if down else 1] * distance_m / (1e-3 * FOCAL_MM)

    def texture(x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        return 0.6 + 0.3 * np.cos(2 * np.pi * per_px / pitch_m * (y_m if down else x_m))

    return texture


def wave_of(values: np.ndarray, per_px: float) -> complex:
    """Return contrast x exp(i phase at the middle) of 1 + contrast cos along an axis."""
    place = np.arange(len(values)) - 0.5 * (len(values) - 1)
    turn = 2 * np.pi * per_px * place
    design = np.stack([np.ones_like(turn), np.cos(turn), np.sin(turn)], axis=-1)
    mean, cos, sin = np.linalg.lstsq(design, values, rcond=None)[0]
    return complex(cos / mean, -sin / mean)


def near_edge(edge_px: float, near_m: float, far_m: float, near: float, far: float) -> Scene:
    """Return a near card that ends `edge_px` pixels right of the middle before a far wall."""
    edge_m = edge_px * ODD.pitch_mm[1] / FOCAL_MM * near_m
    card = Rectangle(centre_m=(edge_m - 1.0, 0.0, near_m), size_m=(2.0, 2.0), reflectance=near)
    return Scene((card,), Plane(centre_m=(0.0, 0.0, far_m), reflectance=far))


def phasors(amplitude: np.ndarray, distance_m: np.ndarray, hz: float = HZ) -> np.ndarray:
    """Return amplitude x exp(4 pi i f d / c)."""
    return amplitude * np.exp(4j * np.pi * hz * distance_m / LIGHT_MPS)


def still(scene: Scene, camera: TofCamera, **options: Any) -> Any:
    """Take one frame with the lens at rest."""
    return simulate_tof(scene, camera, [(0.0, 0.0)], **(EXACT | options))
