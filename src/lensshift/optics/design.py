"""Design with stock lenses: the gaps and orientations that make a train of them sharpest."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

from lensshift.optics.gaps import MOST_ELEMENTS, Effort, best_gaps, none_reaches, train_lens
from lensshift.optics.goal import Goal
from lensshift.optics.lens import Element, Lens
from lensshift.optics.shift import decenter_for_shift, largest_error_px
from lensshift.optics.spots import spots
from lensshift.optics.which import DIAGONALS, edge_fields, least_mtf

_RINGS = 10  # of the light that arrives
_ROUNDING_MM = 1e-3  # more than five gaps of four digits lose together


@dataclass(frozen=True, slots=True)
class Design:
    """A train of stock lenses with its gaps, and what it does.

    Parameters
    ----------
    lens : the train
    element : number of the element that moves, from 0, or None
    turned : which elements stand the other way round than they were given
    mtf_centred : least MTF (`least_mtf`)
    mtf_moved : the same over the four diagonal moves; that at rest if no element moves
    shift_error_px : largest error of the shift over the sensor, 0 if no element moves
    stroke_mm : decentre of the element along one axis, negative if the image goes the other way
    transmission : least share of the light through the stop over the sensor
    """

    lens: Lens
    element: int | None
    turned: tuple[bool, ...]
    mtf_centred: float
    mtf_moved: float
    shift_error_px: float
    stroke_mm: float
    transmission: float

    def meets(self, goal: Goal) -> bool:
        """Tell whether MTF, shift error and back focal distance are as wanted."""
        return (
            min(self.mtf_centred, self.mtf_moved) >= goal.mtf
            and self.shift_error_px <= goal.shift_error_px
            and self.back_focal_mm >= goal.back_focal_mm - _ROUNDING_MM
        )

    @property
    def back_focal_mm(self) -> float:
        """From the last vertex of the train to the sensor."""
        count = len(self.turned)
        ends_mm = self.lens.positions_mm()[count - 1] + self.lens.elements[count - 1].length_mm
        return float(self.lens.positions_mm()[-1] - ends_mm)


def optimise_gaps(
    elements: Sequence[Element],
    goal: Goal,
    *,
    element: int | None = None,
    turn: bool = True,
    name: str = "",
    on_progress: Callable[[int, int], None] | None = None,
) -> Design:
    """Return the train of these elements, in this order, that is sharpest over the field.

    Maximises the least fast MTF over fields, azimuths and positions of the moved element, over
    all gaps and the sensor position; a shift error above the limit costs 10 per px. A grid search
    over the free gaps, refined around its best point.

    Parameters
    ----------
    elements : in the order in which light meets them, at least two
    element : number of the element that moves, from 0, or None
    turn : also try each element the other way round
    name : of the lens
    on_progress : is told how many of all orientations are done

    Raises
    ------
    ValueError
        If there are fewer than two or more than five elements, or no gaps give the focal length
        with room for all elements, the back focal distance and the light.
    """
    if not 2 <= len(elements) <= MOST_ELEMENTS:
        raise ValueError(f"expected 2 to {MOST_ELEMENTS} elements, got {len(elements)}")
    if element is not None and not 0 <= element < len(elements):
        raise ValueError(f"expected an element from 0 to {len(elements) - 1}, got {element}")
    choices = list(orientations(len(elements))) if turn else [(False,) * len(elements)]
    found = []
    for done, turned in enumerate(choices, start=1):
        train = turned_train(elements, turned)
        if (best := best_gaps(train, goal, element, Effort())) is not None:
            found.append((*best, train, turned))
        if on_progress is not None:
            on_progress(done, len(choices))
    if not found:
        raise none_reaches([turned_train(elements, one) for one in choices], goal, "orientations")
    _, gaps_mm, train, turned = max(found, key=lambda one: one[0])
    return assess(train_lens(train, gaps_mm, goal, name), goal, element, turned)


def orientations(count: int) -> Iterator[tuple[bool, ...]]:
    """Return every choice of which of `count` elements are turned round."""
    return product((False, True), repeat=count)


def turned_train(elements: Sequence[Element], turned: Sequence[bool]) -> tuple[Element, ...]:
    """Return the elements, some of them turned round."""
    return tuple(e.reversed() if t else e for e, t in zip(elements, turned, strict=True))


def assess(lens: Lens, goal: Goal, element: int | None, turned: tuple[bool, ...]) -> Design:
    """Return the design of a finished lens: least MTF, shift error over the sensor."""
    error_px = stroke_mm = 0.0
    if element is not None:
        wanted_px = goal.shift_px * DIAGONALS
        moves_mm = decenter_for_shift(lens, element, wanted_px, goal.grid)
        error_px = largest_error_px(lens, element, moves_mm, goal.grid, wanted_px)
        stroke_mm = float(moves_mm[0, 1])
    rest, moved = least_mtf(
        lens, goal.grid, element, shift_px=goal.shift_px, frequency_lpmm=goal.judged_lpmm,
        band=goal.band,
    )  # fmt: skip
    light = spots(lens, edge_fields(lens, goal.grid), rings=_RINGS).transmission
    return Design(
        lens, element, tuple(turned), rest, moved, error_px, stroke_mm, float(light.min())
    )
