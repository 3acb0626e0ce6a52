"""First-order data: focal length, pupils, magnification, and what a small decentre does."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.optics.lens import Element, Lens


@dataclass(frozen=True, slots=True)
class Paraxial:
    """The first-order data of a lens.

    Parameters
    ----------
    focal_length_mm : effective focal length
    back_focal_mm : from the last vertex to the image of an infinitely far object
    image_mm : from the last vertex to the paraxial image of the object
    magnification : of the object on the sensor side, 0 for an infinitely far object
    entrance_pupil_mm : position from the first vertex
    entrance_pupil_diameter_mm : image of the stop seen from the object
    exit_pupil_mm : position from the last vertex; infinite if chief rays leave along the axis
    exit_pupil_diameter_mm : image of the stop seen from the sensor; infinite in that case
    f_number : focal length over entrance pupil diameter
    working_f_number : 1 / (2 sin of the marginal ray's paraxial slope) at the image
    """

    focal_length_mm: float
    back_focal_mm: float
    image_mm: float
    magnification: float
    entrance_pupil_mm: float
    entrance_pupil_diameter_mm: float
    exit_pupil_mm: float
    exit_pupil_diameter_mm: float
    f_number: float
    working_f_number: float


def paraxial(lens: Lens, wavelength_nm: float | None = None) -> Paraxial:
    """Return the first-order data of the centred lens.

        (height, slope)_behind = M (height, slope)_before,    focal length = -1 / M_10

    Raises
    ------
    ValueError
        If the lens has no power, the entrance pupil is infinitely far, or the object lies in it.
    """
    front, behind = matrices_around_stop(lens, wavelength_nm)
    system = np.asarray(behind @ front)
    power = float(-system[1, 0])
    if abs(power) < 1e-12:
        raise ValueError("expected a lens with power, got one without a focal length")
    entrance_mm, entrance_scale = _pupil(np.asarray(np.linalg.inv(front)))
    exit_mm, exit_scale = (math.inf, math.inf) if _telecentric(behind) else _pupil(behind)
    image_mm, magnification = _image(system, lens.object_mm)
    pupil_diameter_mm = lens.stop.diameter_mm * abs(entrance_scale)
    # The ray from the middle of the object at unit height on the first vertex.
    entering = np.array([1.0, 1.0 / lens.object_mm])
    at_stop = float(front[0] @ entering)
    if abs(at_stop) < 1e-12:
        raise ValueError(f"expected an object away from the entrance pupil at {entrance_mm:g} mm")
    slope = 0.5 * lens.stop.diameter_mm * float(system[1] @ entering) / at_stop
    return Paraxial(
        focal_length_mm=1.0 / power,
        back_focal_mm=_image(system, math.inf)[0],
        image_mm=image_mm,
        magnification=magnification,
        entrance_pupil_mm=entrance_mm,
        entrance_pupil_diameter_mm=pupil_diameter_mm,
        exit_pupil_mm=exit_mm,
        exit_pupil_diameter_mm=lens.stop.diameter_mm * abs(exit_scale),
        f_number=1.0 / (abs(power) * pupil_diameter_mm),
        working_f_number=0.5 / abs(slope),
    )


def focal_length_mm(element: Element, indices: tuple[float, ...]) -> float:
    """Return the focal length of one element in air, infinite for a plane-parallel plate."""
    power = -element_matrix(element, indices)[1, 0]
    return math.inf if abs(power) < 1e-12 else float(1.0 / power)


def decenter_gains(lens: Lens, wavelength_nm: float | None = None) -> Floats:
    """Return by how much the image moves per decentre of each element, [element].

        gain_j = [ M_j (1 - E_j) (1, 0) ]_height

    with E_j the matrix of element j and M_j that of everything from there to the sensor: an
    element that moves by s adds (1 - E_j) (s, 0) to the ray behind it.
    """
    return gains_of(_elements(lens, wavelength_nm), np.asarray(lens.gaps_mm))


def gains_of(chain: list[Floats], gaps_mm: Floats) -> Floats:
    """Return the gains [... element] of elements with these matrices and gaps [... element]."""
    gains = np.zeros(gaps_mm.shape)
    behind: Floats = np.eye(2)
    for number in range(len(chain) - 1, -1, -1):
        behind = behind @ gap_matrix(gaps_mm[..., number])
        added = (np.eye(2) - chain[number]) @ np.array([1.0, 0.0])
        gains[..., number] = behind[..., 0, :] @ added
        behind = behind @ chain[number]
    return gains


def element_matrix(element: Element, indices: tuple[float, ...]) -> Floats:
    """Return the [2 2] matrix of one element in air, from its first to its last vertex."""
    matrix: Floats = np.eye(2)
    before = 1.0
    for number, surface in enumerate(element.surfaces):
        after = indices[number] if number < len(indices) else 1.0
        bend = (after - before) * surface.vertex_curvature_per_mm / after
        if surface.mirror:  # unfolded
            bend = -2.0 * surface.vertex_curvature_per_mm
        matrix = np.array([[1.0, 0.0], [-bend, before / after]]) @ matrix
        if number < len(indices):
            matrix = gap_matrix(element.thickness_mm[number]) @ matrix
        before = after
    return matrix


def entrance_pupil(lens: Lens) -> tuple[float, float]:
    """Return position from the first vertex in mm, and size over that of the stop."""
    front, _ = matrices_around_stop(lens)
    return _pupil(np.asarray(np.linalg.inv(front)))


def matrices_around_stop(lens: Lens, wavelength_nm: float | None = None) -> tuple[Floats, Floats]:
    """Return the matrices from the first vertex to the stop and from there to the last vertex."""
    before = lens.elements_before_stop()
    starts_mm, stop_mm = lens.positions_mm(), lens.stop.position_mm
    ends_mm = [float(s) + e.length_mm for s, e in zip(starts_mm, lens.elements, strict=False)]
    chain = _elements(lens, wavelength_nm)

    def through(first: int, last: int, from_mm: float, to_mm: float) -> Floats:
        matrix: Floats = np.eye(2)
        for number in range(first, last):
            matrix = chain[number] @ gap_matrix(starts_mm[number] - from_mm) @ matrix
            from_mm = ends_mm[number]
        return np.asarray(gap_matrix(to_mm - from_mm) @ matrix)

    front = through(0, before, 0.0, stop_mm)
    return front, through(before, len(chain), stop_mm, ends_mm[-1])


def _elements(lens: Lens, wavelength_nm: float | None) -> list[Floats]:
    indices = lens.indices(wavelength_nm)
    return [element_matrix(e, n) for e, n in zip(lens.elements, indices, strict=True)]


def gap_matrix(distance_mm: ArrayLike) -> Floats:
    """Return the matrices [... 2 2] of air."""
    matrices = np.zeros((*np.shape(distance_mm), 2, 2))
    matrices[..., 0, 0] = matrices[..., 1, 1] = 1.0
    matrices[..., 0, 1] = distance_mm
    return matrices


def _pupil(matrix: Floats) -> tuple[float, float]:
    """Return where the plane in front of `matrix` is imaged behind it, and the magnification."""
    if _telecentric(matrix):
        raise ValueError("expected a pupil at a finite distance, but the stop is in a focal plane")
    position_mm = -matrix[0, 1] / matrix[1, 1]
    return float(position_mm), float(matrix[0, 0] + position_mm * matrix[1, 0])


def _telecentric(matrix: Floats) -> bool:
    """Tell whether the plane in front of `matrix` is imaged infinitely far behind it."""
    return bool(abs(matrix[1, 1]) < 1e-12)


def _image(system: Floats, object_mm: float) -> tuple[float, float]:
    if math.isinf(object_mm):
        return float(-system[0, 0] / system[1, 0]), 0.0
    matrix = system @ gap_matrix(object_mm)
    image_mm = -matrix[0, 1] / matrix[1, 1]
    return float(image_mm), float(matrix[0, 0] + image_mm * matrix[1, 0])
