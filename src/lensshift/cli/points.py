"""Options of point clouds: where the pixels look, and what becomes a point."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lensshift.cli.verbs import option

if TYPE_CHECKING:
    from lensshift.core.grid import Grid
    from lensshift.core.intrinsics import Intrinsics

CLOUD_SUFFIXES = (".ply", ".pcd")


@dataclass(frozen=True, slots=True)
class PointOptions:
    """Where the pixels look, if the burst does not say or says it wrong, and what is written."""

    fov_deg: str | None = option(None, "Field of view in degrees, border to border: 60, or 60x45.")
    focal_length_px: float | None = option(None, "Focal length in pixels of the camera.")
    focal_length_mm: float | None = option(None, "Focal length.")
    intrinsics_file: Path | None = option(
        None,
        "Camera matrix and distortion: YAML, XML or JSON of OpenCV, camera_info of ROS, NPZ.",
        "--intrinsics",
        metavar="FILE",
    )
    lens: str | None = option(None, "Trace this lens (a name or a file) for directions.")
    normals: bool = option(False, "Normals in .ply and .pcd.")
    keep_flying: bool = option(
        False, "Keep pixels between surfaces, or that no frame shows, in .ply and .pcd."
    )

    def intrinsics(self, grid: Grid, known: Intrinsics | None) -> Intrinsics | None:
        """Return where the pixels of a camera look: as told here, else what is known."""
        from lensshift.core.intrinsics import Pinhole

        by_length = (self.fov_deg, self.focal_length_px, self.focal_length_mm)
        if sum(one is not None for one in (*by_length, self.intrinsics_file, self.lens)) > 1:
            raise typer.BadParameter(
                "--fov-deg, --focal-length-px, --focal-length-mm, --intrinsics and --lens all say "
                "where the pixels look; give one of them"
            )
        if self.intrinsics_file is not None:
            from lensshift.io.camera_matrix import load_pinhole

            return load_pinhole(self.intrinsics_file, grid.shape)
        by_mm = "--focal-length-mm" if self.focal_length_mm is not None else "--lens"
        if (self.focal_length_mm, self.lens) != (None, None) and not grid.tells_pitch():
            raise typer.BadParameter(f"{by_mm} needs to know how large a pixel is: --pitch-mm")
        try:
            if self.fov_deg is not None:
                return Pinhole.of_field(grid, *_angles_rad(self.fov_deg))
            if self.focal_length_px is not None:
                return Pinhole.centred(grid, self.focal_length_px)
            if self.focal_length_mm is not None:
                return Pinhole.of_focal_length(grid, self.focal_length_mm)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from error
        if self.lens is not None:
            from lensshift.optics.directions import lens_directions
            from lensshift.optics.lens_file import load_lens

            return lens_directions(load_lens(self.lens), grid)
        return known


def refuse_points(
    targets: Iterable[Path], intrinsics: Intrinsics | None, *, with_distance: bool
) -> None:
    """Raise a usage error if files of points are wanted where there can be none."""
    for path in targets:
        if path.suffix.lower() not in CLOUD_SUFFIXES:
            continue
        if not with_distance:
            raise typer.BadParameter(f"{path}: points need distances, and there are none")
        if intrinsics is None:
            raise typer.BadParameter(
                f"{path}: points need to know where the pixels look; give --fov-deg, "
                "--focal-length-px, --focal-length-mm, --intrinsics FILE or --lens"
            )


def view_of(intrinsics: Intrinsics | None, shape: tuple[int, int]) -> dict[str, Any] | None:
    """Return the kind of intrinsics and the angles (row, col) between the outermost pixels."""
    import numpy as np

    if intrinsics is None:
        return None
    direction = intrinsics.directions(shape)
    rows, cols = (count // 2 for count in shape)
    ends = ((direction[0, cols], direction[-1, cols]), (direction[rows, 0], direction[rows, -1]))
    angles = [np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b) for a, b in ends]
    return {"kind": type(intrinsics).__name__, "field_deg": np.rad2deg(angles).tolist()}


def view_text(view: dict[str, Any] | None) -> str:
    """Return `view_of` in words."""
    if view is None:
        return "not known where; --fov-deg or a focal length makes points of distances"
    kind = {"Pinhole": "a pinhole", "PixelDirections": "a direction per pixel"}[view["kind"]]
    row, col = view["field_deg"]
    return f"{col:.2f} x {row:.2f} deg between the outermost pixels, {kind}"


def _angles_rad(text: str) -> tuple[float, ...]:
    from math import radians

    try:
        angles_deg = [float(part) for part in text.lower().split("x")]
    except ValueError:
        angles_deg = []
    if len(angles_deg) not in (1, 2):
        raise typer.BadParameter(
            f"expected degrees as in 60 or 60x45, got {text!r}", param_hint="--fov-deg"
        )
    if not all(0.0 < angle < 180.0 for angle in angles_deg):
        raise typer.BadParameter(
            f"expected angles above 0 and below 180 degrees, got {text!r}", param_hint="--fov-deg"
        )
    return tuple(radians(angle) for angle in angles_deg)
