"""What stands before the camera: a world of shapes in metres, and flat targets.

**Coordinates.** The camera is at the origin: x to the right (+col), y down (+row), z forward along
the optical axis, in metres. x, y, z are right-handed: right x down = forward, and a positive turn
about an axis is clockwise for somebody who looks along it. So a positive turn about z takes right
to down, about x down to forward, about y forward to right.

**Half pixel.** The image is the picture as one looks at it, not the one upside down on the chip:
what lies at +x is seen at higher columns, what lies at +y at higher rows. Pixel centres are at
integers, so the axis z meets the sensor at row (rows - 1)/2 and col (cols - 1)/2, between the
pixels where their number is even, and the middle of pixel (row, col) looks along

    ( (col - (cols - 1)/2) pitch_col,  (row - (rows - 1)/2) pitch_row,  focal length )

**Order.** World vectors are (x, y, z), sizes of things in the world (x, y) or (x, y, z); images
and places on the image plane keep (row, col).

`cast` finds what rays meet in a `Scene`. The flat targets (`Target`: radiance as a function of
the place on the image plane) know nothing of the world: they lie where the lens images them.
"""

from lensshift.scene.cast import Hits, cast
from lensshift.scene.flat import (
    BACKGROUND,
    Box,
    Place,
    Target,
    boxes,
    demo_target,
    in_a_row,
    line_pairs,
    siemens_star,
    slanted_edge,
)
from lensshift.scene.shapes import Cuboid, Plane, Rectangle, Scene, Shape, Sphere
from lensshift.scene.textures import Constant, Texture

__all__ = [
    "BACKGROUND",
    "Box",
    "Constant",
    "Cuboid",
    "Hits",
    "Place",
    "Plane",
    "Rectangle",
    "Scene",
    "Shape",
    "Sphere",
    "Target",
    "Texture",
    "boxes",
    "cast",
    "demo_target",
    "in_a_row",
    "line_pairs",
    "siemens_star",
    "slanted_edge",
]
