"""How much of drawn rooms lies within the standard deviations that distances are told with.

python benchmarks/rooms.py --seed 300 --rooms 12

Boxes and spheres, plain, chequered or of two tones, before a slanted wall; of cameras with more
pixels the middle. Stray light is left in, or taken out as the burst tells it, 10 % off. Shares of
HR pixels that mix no surfaces, on the median of the rooms and in the worst; how many rooms warned.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace

import numpy as np

from lensshift import Burst, QualityWarning, StrayLight, reconstruct
from lensshift.camera import TofCamera, camera_preset, simulate_tof
from lensshift.core.grid import Grid
from lensshift.core.units import unambiguous_range_m
from lensshift.scene import Checker, Constant, Cuboid, Edge, Plane, Scene, Sphere

SHAPES = {"o3m151": (16, 64), "pmd_176x132": (66, 88), "vga": (60, 80)}
FARTHEST_M = {"o3m151": (2.0, 9.5), "pmd_176x132": (1.2, 6.0), "vga": (1.2, 6.0)}


def room(rng: np.random.Generator, camera: TofCamera) -> Scene:
    """Return a room that fills the view."""
    far_m = rng.uniform(*FARTHEST_M[camera.name])
    sides_mm = np.array(camera.grid.shape) * camera.grid.pitch_mm
    half = sides_mm / 2 / camera.optics.focal_length_mm  # over the distance, (row, col)

    def surface(size_m: float) -> Checker | Edge | Constant:
        dark, bright = sorted(np.exp(rng.uniform(np.log(0.05), np.log(0.9), 2)))
        kind = rng.integers(5)
        if kind == 0:
            return Checker(size_m * rng.uniform(0.1, 0.6), dark, bright)
        return Edge(rng.uniform(-0.6, 0.6), dark, bright) if kind == 1 else Constant(float(bright))

    objects: list[Cuboid | Sphere] = []
    for _ in range(rng.integers(3, 9)):
        z = far_m * rng.uniform(0.45, 0.95)
        x, y = z * half[1] * rng.uniform(-1, 1), z * half[0] * rng.uniform(-1, 1)
        size_m = z * half[1] * np.exp(rng.uniform(np.log(0.04), np.log(0.5), 3))
        at, of = (x, y, z), surface(float(size_m[0]))
        turn = tuple(np.radians(rng.uniform((-20, -60, -20), (20, 60, 20))))
        ball = rng.random() < 0.2
        one = Sphere(centre_m=at, radius_m=size_m[0] / 2, reflectance=of) if ball else Cuboid(
            centre_m=at, size_m=tuple(size_m), turn_rad=turn, reflectance=of
        )  # fmt: skip
        objects.append(one)
    turn = tuple(np.radians(rng.uniform((-20, -35, 0), (20, 35, 0))))
    wall = Plane(centre_m=(0, 0, far_m), turn_rad=turn, reflectance=surface(far_m * half[1]))
    return Scene(tuple(objects), wall)


def held(burst: Burst, true_m: np.ndarray, of: np.ndarray, stray: StrayLight | None) -> list[float]:
    """Return shares within one and two std, and the median error in mm."""
    found = reconstruct(burst, stray_light=stray).distance_m
    off_m = found.image - true_m
    if len(burst.frequencies_hz) == 1:
        range_m = unambiguous_range_m(burst.frequencies_hz[0])
        off_m = (off_m + range_m / 2) % range_m - range_m / 2
    size, std = np.abs(off_m)[of], found.std[of]
    return [np.mean(size < std), np.mean(size < 2 * std), 1e3 * np.median(size)]


def main() -> None:
    """Print two lines for each camera."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=300)
    parser.add_argument("--rooms", type=int, default=12, help="before each camera")
    args = parser.parse_args()
    print("camera       stray light  1 std: median, least  2 std: median, least  off mm  warned")
    for name, shape in SHAPES.items():
        camera = camera_preset(name)
        camera = replace(camera, grid=Grid(shape, camera.grid.pitch_mm))
        rows: dict[str, list[list[float]]] = {"left in": [], "taken out": []}
        warned = dict.fromkeys(rows, 0)
        for seed in range(args.seed, args.seed + args.rooms):
            with warnings.catch_warnings(action="ignore", category=QualityWarning):
                taken = simulate_tof(room(np.random.default_rng(seed), camera), camera, seed=seed)
            of = taken.truth.valid & ~taken.truth.flying
            for how, stray in (("left in", StrayLight(0.0, 8.0)), ("taken out", None)):
                with warnings.catch_warnings(record=True) as said:
                    warnings.simplefilter("always", QualityWarning)
                    rows[how].append(held(taken.burst, taken.truth.distance_m, of, stray))
                warned[how] += bool(said)
        for how, each in rows.items():
            (one, two, off_mm), (least_1, least_2, _) = np.median(each, 0), np.min(each, 0)
            print(f"{name:12s} {how:11s}  {one:13.2f} {least_1:6.2f}  {two:13.2f} {least_2:6.2f}"
                  f"  {off_mm:6.1f}  {warned[how]:6d}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
