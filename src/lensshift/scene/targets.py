"""Targets to measure a camera with, in the world.

All stand on the optical axis, half a metre before a wall of black fabric.
"""

from __future__ import annotations

import math
from importlib import resources

from lensshift.scene.checks import positive
from lensshift.scene.scene_file import parse_scene
from lensshift.scene.shapes import Plane, Rectangle, Scene
from lensshift.scene.textures import BRIGHT, DARK, Edge, SiemensStar, Texture, ZonePlate

SLANT_RAD = math.radians(10.0)
CARD_M = 0.6  # side of a card, higher than the view of an O3M at its distance
CARD_DISTANCE_M = 3.5  # as in the paper
_FABRIC = 0.04  # reflectance of black fabric


def slanted_edge_card(
    slant_rad: float = SLANT_RAD,
    *,
    dark: float = DARK,
    bright: float = BRIGHT,
    distance_m: float = CARD_DISTANCE_M,
) -> Scene:
    """Return a card of 600 x 600 mm, dark on the left, bright on the right of a slanted edge.

    The edge crosses the optical axis and moves right as it goes down for a positive slant.

    Parameters
    ----------
    slant_rad : of the edge from the vertical
    dark, bright : reflectances
    distance_m : of the card along the optical axis
    """
    return _card(Edge(slant_rad, dark, bright), distance_m)


def siemens_star_card(
    radius_m: float = 0.095,
    *,
    cycles: int = 12,
    binary: bool = False,
    dark: float = DARK,
    bright: float = BRIGHT,
    distance_m: float = CARD_DISTANCE_M,
) -> Scene:
    """Return a Siemens star on a grey card; by default it fills the height of 16 pixels.

    Parameters
    ----------
    radius_m, cycles, binary, dark, bright : of the `SiemensStar`
    distance_m : of the card along the optical axis
    """
    return _card(SiemensStar(radius_m, cycles, dark, bright, binary), distance_m)


def zone_plate_card(
    radius_m: float = 0.28,
    finest_period_m: float = 0.0125,
    *,
    dark: float = DARK,
    bright: float = BRIGHT,
    distance_m: float = CARD_DISTANCE_M,
) -> Scene:
    """Return a zone plate on a grey card; by default its last ring is one pixel wide.

    Parameters
    ----------
    radius_m, finest_period_m, dark, bright : of the `ZonePlate`
    distance_m : of the card along the optical axis
    """
    return _card(ZonePlate(radius_m, finest_period_m, dark, bright), distance_m)


def slanted_depth_step(
    slant_rad: float = SLANT_RAD,
    *,
    near_m: float = 3.4,
    step_m: float = 0.3,
    near_reflectance: float = 0.5,
    far_reflectance: float = 0.5,
) -> Scene:
    """Return a near card on the left that hides part of a far one, as a slanted edge in distance.

    The near edge crosses the optical axis and moves right as it goes down for a positive slant.

    Parameters
    ----------
    slant_rad : of the edge from the vertical, up to 45 degrees
    near_m : of the near card along the optical axis
    step_m : from the near to the far card
    near_reflectance, far_reflectance : of the cards

    Raises
    ------
    ValueError
        If the slant is larger, or a distance is not positive.
    """
    if not abs(slant_rad) <= math.pi / 4:
        raise ValueError(f"expected slant_rad from -pi/4 to pi/4, got {slant_rad}")
    positive("near_m", near_m)
    positive("step_m", step_m)
    # Twice as high as the far card, so that none of its ends shows however it is turned.
    width_m, height_m = CARD_M, 2 * CARD_M
    to_centre_m = 0.5 * width_m
    near = Rectangle(
        centre_m=(-to_centre_m * math.cos(slant_rad), to_centre_m * math.sin(slant_rad), near_m),
        size_m=(width_m, height_m),
        turn_rad=(0.0, 0.0, -slant_rad),
        reflectance=near_reflectance,
        name="near card",
    )
    far = Rectangle(
        centre_m=(0.0, 0.0, near_m + step_m),
        size_m=(2 * CARD_M, 2 * CARD_M),
        reflectance=far_reflectance,
        name="far card",
    )
    return Scene((near, far), background=_wall(near_m + step_m))


def four_boxes() -> Scene:
    """Return four cubes of different size, reflectance and orientation.

    The sizes are those of `four_boxes.toml` in the package; copy and change it, and read your
    own with `load_scene`.
    """
    file = resources.files("lensshift.scene") / "four_boxes.toml"
    return parse_scene(file.read_text(encoding="utf-8"), source="four_boxes.toml")


def _card(texture: Texture, distance_m: float) -> Scene:
    positive("distance_m", distance_m)
    card = Rectangle(
        centre_m=(0.0, 0.0, distance_m), size_m=(CARD_M, CARD_M), reflectance=texture, name="card"
    )
    return Scene((card,), background=_wall(distance_m))


def _wall(target_m: float) -> Plane:
    return Plane(centre_m=(0.0, 0.0, target_m + 0.5), reflectance=_FABRIC, name="wall")
