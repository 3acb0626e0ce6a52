"""What it costs to take a radial distance for a depth: a flat wall as points in space.

python examples/flat_wall.py [--camera o3m151] [--out wall.ply]

A simulated camera without noise looks at a slanted wall; the result becomes points twice, with its
distances taken for z, as programs do that expect depth images, and along the direction of each
pixel. The distances of both from the plane that fits best are printed.
"""

import argparse

import numpy as np

import lensshift
from lensshift.camera import camera_preset, preset_names, simulate_tof_burst
from lensshift.io import save_point_cloud
from lensshift.scene import Plane, Scene


def main() -> None:
    """Print how flat the wall is both ways, and write its points."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--camera", default="o3m151", choices=preset_names())
    parser.add_argument("--out", help="write the points there: .ply, .pcd or .npz")
    arguments = parser.parse_args()
    wall = Scene((Plane(centre_m=(0.0, 0.0, 3.0), turn_rad=(0.1, -0.2, 0.0), reflectance=0.5),))
    camera = camera_preset(arguments.camera).ideal()
    burst, _ = simulate_tof_burst(wall, camera, shift_error_px=0.0, samples_per_px=4)
    result = lensshift.reconstruct(burst, scale=2, std=False)
    cloud = result.point_cloud(normals=True)
    forward = cloud.point_m[:, 2] / np.linalg.norm(cloud.point_m, axis=1)
    for label, point_m in (
        ("distance taken for z", cloud.point_m / forward[:, None]),
        ("along the directions", cloud.point_m),
    ):
        off_m = off_plane_m(point_m)
        print(f"{label}  {1e3 * off_m.std():8.3f} mm rms {1e3 * np.ptp(off_m):9.3f} mm in all")
    if arguments.out:
        save_point_cloud(cloud, arguments.out)
        print(f"wrote {arguments.out}")


def off_plane_m(point_m: np.ndarray) -> np.ndarray:
    """Return the distances of points [n 3] from the plane that fits best."""
    away_m = point_m - point_m.mean(axis=0)
    return away_m @ np.linalg.svd(away_m, full_matrices=False)[2][-1]


if __name__ == "__main__":
    main()
