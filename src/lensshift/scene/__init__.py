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

from lensshift.scene.cast import Hits, cast, visible
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
from lensshift.scene.mesh import Mesh, load_mesh
from lensshift.scene.scene_file import load_scene, save_scene
from lensshift.scene.shapes import Cuboid, Plane, Rectangle, Scene, Shape, Sphere
from lensshift.scene.targets import (
    four_boxes,
    siemens_star_card,
    slanted_depth_step,
    slanted_edge_card,
    zone_plate_card,
)
from lensshift.scene.textures import (
    Checker,
    Constant,
    Edge,
    ImageTexture,
    LinePairs,
    SiemensStar,
    Texture,
    ZonePlate,
)

__all__ = [
    "BACKGROUND",
    "Box",
    "Checker",
    "Constant",
    "Cuboid",
    "Edge",
    "Hits",
    "ImageTexture",
    "LinePairs",
    "Mesh",
    "Place",
    "Plane",
    "Rectangle",
    "Scene",
    "Shape",
    "SiemensStar",
    "Sphere",
    "Target",
    "Texture",
    "ZonePlate",
    "boxes",
    "cast",
    "demo_target",
    "four_boxes",
    "in_a_row",
    "line_pairs",
    "load_mesh",
    "load_scene",
    "save_scene",
    "siemens_star",
    "siemens_star_card",
    "slanted_depth_step",
    "slanted_edge",
    "slanted_edge_card",
    "visible",
    "zone_plate_card",
]
