"""Things in the world: where they stand, how they are turned, and how much light they scatter.

All surfaces are opaque Lambertian scatterers with two equal sides: a camera inside a cuboid sees
its walls.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Array
from lensshift.scene.checks import numbers, positive, positives, share
from lensshift.scene.kernels import meet_cuboid, meet_rectangle, meet_sphere
from lensshift.scene.textures import Constant, Texture

Vector = tuple[float, float, float]


@dataclass(slots=True)
class Rays:
    """Rays and the nearest thing that they have met so far; shapes change it in place."""

    # [ray 3], directions of length 1
    origin_m: Array
    direction: Array
    distance_m: Array  # [ray] to what was met, at first how far to look
    shape: Array  # [ray] index of the shape that was met, -1 for none
    part: Array  # [ray] which face of it

    @classmethod
    def launch(cls, origin_m: Array, direction: Array, limit_m: ArrayLike = np.inf) -> Rays:
        """Return rays that have met nothing yet."""
        count = len(direction)
        return cls(
            origin_m=np.array(np.broadcast_to(origin_m, (count, 3)), dtype=np.float64, order="C"),
            direction=np.ascontiguousarray(direction),  # kernels are compiled for one layout
            distance_m=np.array(np.broadcast_to(limit_m, (count,)), dtype=np.float64),
            shape=np.full(count, -1, dtype=np.int64),
            part=np.zeros(count, dtype=np.int64),
        )

    def arrays(self) -> tuple[Array, Array, Array, Array, Array]:
        """Return the arrays in the order in which kernels take them."""
        return self.origin_m, self.direction, self.distance_m, self.shape, self.part


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape(ABC):
    """What all shapes have.

    Parameters
    ----------
    centre_m : (x, y, z) in the world
    turn_rad : about the axes x, y, z of the world, in this order, with the centre at rest
    reflectance : 0 to 1, or a texture of the coordinates on the surface
    name : for messages
    """

    centre_m: Vector
    turn_rad: Vector = (0.0, 0.0, 0.0)
    reflectance: float | Texture = 0.5
    name: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre_m", numbers("centre_m", self.centre_m, 3))
        object.__setattr__(self, "turn_rad", numbers("turn_rad", self.turn_rad, 3))
        if not callable(self.reflectance):
            share("reflectance", self.reflectance)
        if not isinstance(self.name, str):
            raise TypeError(f"expected a text for name, got {self.name!r}")

    @cached_property
    def rotation(self) -> Array:
        """[3 3] from the axes of the shape, its columns, to the world."""
        (cx, cy, cz), (sx, sy, sz) = np.cos(self.turn_rad), np.sin(self.turn_rad)
        about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        return np.ascontiguousarray(about_z @ about_y @ about_x)

    @property
    def texture(self) -> Texture:
        """The reflectance as a function of the coordinates on the surface."""
        return self.reflectance if callable(self.reflectance) else Constant(self.reflectance)

    @property
    def _pose(self) -> tuple[Array, Array]:
        return np.array(self.centre_m, dtype=np.float64), self.rotation

    @abstractmethod
    def meet(self, rays: Rays, index: int) -> None:
        """Note where this shape is the nearest that rays have met, under `index`."""

    @abstractmethod
    def surface(self, point_m: Array, part: Array) -> tuple[Array, Array, Array]:
        """Return what is at points on the surface, in the axes of the shape.

        Parameters
        ----------
        point_m : [point 3] from the centre
        part : [point] as `meet` noted it

        Returns
        -------
        normal [point 3] of length 1, to either side; x_m, y_m [point] for the texture
        """


@dataclass(frozen=True, kw_only=True)
class Plane(Shape):
    """An endless plane, across z unless turned.

    Texture: x and y from the centre.
    """

    def meet(self, rays: Rays, index: int) -> None:
        """Note where the plane is the nearest that rays have met."""
        meet_rectangle(*rays.arrays(), index, *self._pose, np.full(2, np.inf))

    def surface(self, point_m: Array, part: Array) -> tuple[Array, Array, Array]:
        """Return normal and texture coordinates at points of the plane."""
        return np.broadcast_to([0.0, 0.0, 1.0], point_m.shape), point_m[:, 0], point_m[:, 1]


@dataclass(frozen=True, kw_only=True)
class Rectangle(Plane):
    """A card without thickness, across z unless turned.

    Parameters
    ----------
    size_m : along (x, y)
    """

    size_m: tuple[float, float]

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "size_m", positives("size_m", self.size_m, 2))

    def meet(self, rays: Rays, index: int) -> None:
        """Note where the card is the nearest that rays have met."""
        meet_rectangle(*rays.arrays(), index, *self._pose, 0.5 * np.array(self.size_m))


@dataclass(frozen=True, kw_only=True)
class Cuboid(Shape):
    """A box.

    Texture: from the middle of each face, (x, y) on the faces across z, (z, y) across x, and
    (x, z) across y.

    Parameters
    ----------
    size_m : along (x, y, z), before it is turned
    """

    size_m: Vector

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "size_m", positives("size_m", self.size_m, 3))

    def meet(self, rays: Rays, index: int) -> None:
        """Note where the box is the nearest that rays have met."""
        meet_cuboid(*rays.arrays(), index, *self._pose, 0.5 * np.array(self.size_m))

    def surface(self, point_m: Array, part: Array) -> tuple[Array, Array, Array]:
        """Return normal and texture coordinates at points of the faces across axis `part`."""
        x_m = np.where(part == 0, point_m[:, 2], point_m[:, 0])
        y_m = np.where(part == 1, point_m[:, 2], point_m[:, 1])
        return np.eye(3)[part], x_m, y_m


@dataclass(frozen=True, kw_only=True)
class Sphere(Shape):
    """A ball.

    Texture: longitude and latitude times the radius, (0, 0) at the side of -z, which faces a
    camera in front of it; longitude towards x, latitude towards y.
    """

    radius_m: float

    def __post_init__(self) -> None:
        super().__post_init__()
        positive("radius_m", self.radius_m)

    def meet(self, rays: Rays, index: int) -> None:
        """Note where the ball is the nearest that rays have met."""
        meet_sphere(*rays.arrays(), index, *self._pose, float(self.radius_m))

    def surface(self, point_m: Array, part: Array) -> tuple[Array, Array, Array]:
        """Return normal and texture coordinates at points of the ball."""
        normal = point_m / np.linalg.norm(point_m, axis=1, keepdims=True)
        longitude = np.arctan2(normal[:, 0], -normal[:, 2])
        latitude = np.arcsin(np.clip(normal[:, 1], -1.0, 1.0))
        return normal, self.radius_m * longitude, self.radius_m * latitude


@dataclass(frozen=True)
class Scene:
    """Everything that a camera at the origin may see.

    Parameters
    ----------
    objects : shapes; each hides what lies behind it
    background : one shape more, such as the wall behind the objects, or None: rays that miss all
        objects see nothing
    """

    objects: tuple[Shape, ...]
    background: Shape | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "objects", tuple(self.objects))
        for shape in self.shapes:
            if not isinstance(shape, Shape):
                raise TypeError(f"expected shapes in a scene, got {type(shape).__name__}")

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The objects and, last, the background."""
        return self.objects if self.background is None else (*self.objects, self.background)
