"""Write a lens as a sequential Zemax file (.zmx)."""

from __future__ import annotations

import math
from pathlib import Path

from lensshift.core.atomic import write_text
from lensshift.optics.glass import REFERENCE_TEMPERATURE_C
from lensshift.optics.lens import Element, Lens, Surface
from lensshift.optics.paraxial import entrance_pupil
from lensshift.optics.zmx_shapes import MOST_PARAMETERS

_GLASS_NAMES = {"fused silica": "F_SILICA"}


def save_zmx(lens: Lens, path: str | Path) -> None:
    """Write a lens as a sequential .zmx file, millimetres and degrees.

    A decentred or tilted element, or a surface that leans, stands between two coordinate breaks,
    the second of which returns to the axis exactly. The stop becomes a plane of its own. Behind a
    mirror distances are negative, as the format wants.

    Raises
    ------
    ValueError
        If the stop rides on an element that is decentred, a mirror is tilted, or a surface has
        even and odd powers of its radius: the format cannot say so.
    DataError
        If the file cannot be written.
    """
    write_text(path, format_zmx(lens))


def format_zmx(lens: Lens) -> str:
    """Return the text of the .zmx file of a lens; see `save_zmx`."""
    stop = lens.stop
    if stop.rides_on is not None and any(lens.elements[stop.rides_on].decenter_mm):
        raise ValueError("expected a stop fixed in space, or on an element that is not decentred")
    pupil_mm = stop.diameter_mm * abs(entrance_pupil(lens)[1])
    adjusted = lens.temperature_c != REFERENCE_TEMPERATURE_C  # else programs ignore it
    header = [
        "MODE SEQ",
        f"NAME {lens.name}",
        "UNIT MM X W X CM MR CPMM",
        f"ENPD {_number(pupil_mm)}",
        f"ENVD {_number(lens.temperature_c)} 1 {int(adjusted)}",
        "GCAT SCHOTT OHARA MISC",
        "FTYP 0 0 1 1 0 0 0",
        "XFLN 0",
        "YFLN 0",
        "FWGN 1",
        f"WAVM 1 {_number(1e-3 * lens.wavelength_nm)} 1",
        "PWAV 1",
    ]
    blocks = _blocks(lens)
    body = [f"SURF {n}\n" + "\n".join(f"  {line}" for line in b) for n, b in enumerate(blocks)]
    return "\n".join([*header, *body]) + "\n"


def _blocks(lens: Lens) -> list[list[str]]:
    """Return the lines of each surface, from the object to the image."""
    before, starts_mm = lens.elements_before_stop(), lens.positions_mm()
    stop_mm, ahead = lens.stop.position_mm, 1.0
    far = math.isinf(lens.object_mm)
    to_stop_mm = stop_mm if before == 0 else 0.0
    blocks = [_plane(math.inf if far else lens.object_mm + to_stop_mm)]
    for number, (element, gap_mm) in enumerate(zip(lens.elements, lens.gaps_mm, strict=True)):
        if number == before:
            blocks.append(_stop(lens, ahead * (float(starts_mm[number]) - stop_mm)))
        if number + 1 == before:
            gap_mm = stop_mm - (float(starts_mm[number]) + element.length_mm)
        blocks += _element(element, gap_mm, ahead)
        ahead *= -1.0 if element.folds else 1.0
    if before == len(lens.elements):
        blocks.append(_stop(lens, ahead * (float(starts_mm[-1]) - stop_mm)))
    return [*blocks, _plane(0.0)]


def _element(element: Element, gap_mm: float, ahead: float) -> list[list[str]]:
    """Return the lines of an element that light meets along (1) or against (-1) the z axis."""
    if any(element.tilt_rad) and any(surface.mirror for surface in element.surfaces):
        raise ValueError(f"expected mirrors that are not tilted, got {element.name} tilted")
    away = any((*element.decenter_mm, *element.tilt_rad))
    place = (*element.decenter_mm[::-1], *_turn_deg(element.tilt_rad, ahead))
    blocks = [_break(place, 0.0)] if away else []
    length_mm = 0.0
    for number, surface in enumerate(element.surfaces):
        shape = surface if ahead > 0 else surface.reversed()
        ahead = -ahead if surface.mirror else ahead
        if number < len(element.glass):
            glass, distance_mm = element.glass[number], ahead * element.thickness_mm[number]
            length_mm += distance_mm
        else:  # back to the first vertex, about which the element is tilted
            glass, distance_mm = "", -length_mm if away else ahead * gap_mm
        if any(surface.tilt_rad):
            lean = (0.0, 0.0, *_turn_deg(surface.tilt_rad, ahead))
            blocks += [_break(lean, 0.0), _surface(shape, glass, 0.0)]
            blocks.append(_break(lean, distance_mm, back=True))
        else:
            blocks.append(_surface(shape, "MIRROR" if surface.mirror else glass, distance_mm))
    if element.name.strip():  # as the comment of its first surface
        first = next(block for block in blocks if "TYPE COORDBRK" not in block)
        first.insert(1, f"COMM {' '.join(element.name.split())}")
    return [*blocks, _break(place, length_mm + ahead * gap_mm, back=True)] if away else blocks


def _turn_deg(tilt_rad: tuple[float, float], ahead: float) -> tuple[float, float]:
    """Return the turns about x and y that lean an axis towards (row, col)."""
    return -ahead * math.degrees(tilt_rad[0]), ahead * math.degrees(tilt_rad[1])


def _surface(surface: Surface, glass: str, distance_mm: float) -> list[str]:
    kind = "STANDARD"
    parameters: tuple[float, ...] = ()
    square = surface.radial[1] if len(surface.radial) > 1 else 0.0
    if surface.asphere or (square and len(surface.radial) == 2 and not surface.radial[0]):
        if any(surface.radial[:1]) or any(surface.radial[2:]):
            raise ValueError("expected even powers of the radius in a surface, or others alone")
        kind, parameters = "EVENASPH", (square, *surface.asphere)
    elif surface.radial:
        kind, parameters = "ODDASPHE", surface.radial
    lines = [f"TYPE {kind}", f"CURV {_number(surface.curvature_per_mm)}"]
    if surface.conic:
        lines.append(f"CONI {_number(surface.conic)}")
    key = "PARM"
    if len(parameters) > MOST_PARAMETERS:  # the extended ones begin with their number and a unit
        lines[0] = f"TYPE {'XASPHERE' if kind == 'EVENASPH' else 'XODDASPH'}"
        key, parameters = "XDAT", (float(len(parameters)), 1.0, *parameters)
    for number, coefficient in enumerate(parameters, start=1):
        lines.append(f"{key} {number} {_number(coefficient)}")
    lines.append(f"DISZ {_number(distance_mm)}")
    if glass.startswith("model:"):
        index, abbe, partial = glass.split(":")[1:]
        lines.append(f"GLAS ___BLANK 1 0 {index} {abbe} {partial} 0 0 0 0 0")
    elif glass:
        lines.append(f"GLAS {_GLASS_NAMES.get(glass, glass)}")
    if math.isfinite(surface.semi_diameter_mm):
        lines.append(f"DIAM {_number(surface.semi_diameter_mm)} 1 0 0 1")
    if surface.inner_mm:
        lines.append(f"CLAP {_number(surface.inner_mm)} {_number(surface.semi_diameter_mm)} 0")
    return lines


def _stop(lens: Lens, distance_mm: float) -> list[str]:
    return ["STOP", *_plane(distance_mm), f"DIAM {_number(0.5 * lens.stop.diameter_mm)} 1 0 0 1"]


def _plane(distance_mm: float) -> list[str]:
    return ["TYPE STANDARD", "CURV 0.0", f"DISZ {_number(distance_mm)}"]


def _break(place: tuple[float, ...], distance_mm: float, *, back: bool = False) -> list[str]:
    """Return the break to a place (x, y, turns about x and y), or exactly back from it."""
    values = (*(-one if back else one for one in place), 0.0, float(back))
    lines = [f"PARM {number} {_number(value)}" for number, value in enumerate(values, start=1)]
    return ["TYPE COORDBRK", "CURV 0.0", *lines, f"DISZ {_number(distance_mm)}"]


def _number(value: float) -> str:
    return "INFINITY" if math.isinf(value) else repr(float(value))
