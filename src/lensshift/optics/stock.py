"""Search a stock of lenses: which ones, which way round, how far apart, and which one to move."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import product

from lensshift.optics.design import Design, assess, orientations, turned_train
from lensshift.optics.gaps import Effort, best_gaps, none_reaches, train_lens
from lensshift.optics.goal import Goal
from lensshift.optics.lens import Element, Lens

_USELESS = 0.1  # MTF below which a train is not worth a closer look

# A first look at every train, at rest only.
_GLANCE = Effort(rings=3, azimuths=3, fields=((0, 0), (0, 1), (1, 1)), rounds=1)


def search_stock(
    places: Sequence[Iterable[Lens | Element]],
    goal: Goal,
    *,
    movers: Sequence[int | None] | None = None,
    keep: int = 16,
    on_progress: Callable[[int, int], None] | None = None,
) -> tuple[Design, ...]:
    """Return the best trains of stock lenses, best first.

    Every choice of a lens for each place in every orientation gets a quick look with all elements
    centred; the best `keep` of them are optimised as by `optimise_gaps` for each moving element.
    Designs that meet the goal come first, then the sharper ones when moved.

    Parameters
    ----------
    places : [place] the lenses that may stand there, from the object on, each of one element
    movers : numbers of the elements that may move; by default each of them, None for none
    keep : trains that are optimised
    on_progress : is told how many steps of how many are done

    Raises
    ------
    ValueError
        If there are fewer than two places, a place has no lens or one of several elements, or no
        train reaches the focal length.
    """
    stock = [[_single(one) for one in place] for place in places]
    if len(stock) < 2 or not all(stock):
        raise ValueError(f"expected at least two places with lenses, got {list(map(len, stock))}")
    trains = [(chosen, turned) for chosen in product(*stock) for turned in orientations(len(stock))]
    moving = list(range(len(stock))) if movers is None else list(movers)
    total = len(trains) + min(keep, len(trains)) * len(moving)
    glances = []
    for done, (chosen, turned) in enumerate(trains, start=1):
        found = best_gaps(turned_train(chosen, turned), goal, None, _GLANCE)
        if found is not None and found[0] > _USELESS:
            glances.append((found[0], chosen, turned))
        if on_progress is not None:
            on_progress(done, total)
    glances.sort(key=lambda glance: -glance[0])
    designs = []
    for rank, (_, chosen, turned) in enumerate(glances[:keep]):
        for number, element in enumerate(moving, start=1):
            train = turned_train(chosen, turned)
            found = best_gaps(train, goal, element, Effort())
            if found is not None and found[0] > _USELESS:
                lens = train_lens(train, found[1], goal, " + ".join(one.name for one in chosen))
                designs.append(assess(lens, goal, element, turned))
            if on_progress is not None:
                on_progress(len(trains) + rank * len(moving) + number, total)
    if not designs:
        raise none_reaches([turned_train(*one) for one in trains], goal, "trains")
    return tuple(sorted(designs, key=lambda one: (not one.meets(goal), -one.mtf_moved)))


def format_designs(designs: Sequence[Design]) -> str:
    """Return the table of `search_stock` as lines of text."""
    lines = ["train (r = turned round)                       moves  MTF rest  moved  shift error  "
             " stroke  gaps"]  # fmt: skip
    for one in designs:
        train = ", ".join(
            element.name + (" r" if turned else "")
            for element, turned in zip(one.lens.elements, one.turned, strict=False)
        )
        moves = "none" if one.element is None else str(one.element + 1)
        gaps = " ".join(f"{gap_mm:.3f}" for gap_mm in one.lens.gaps_mm)
        lines.append(
            f"{train:<47.47} {moves:>4} {one.mtf_centred:9.3f} {one.mtf_moved:6.3f} "
            f"{one.shift_error_px:9.4f} px {1e3 * one.stroke_mm:6.1f} um  {gaps} mm"
        )
    return "\n".join(lines)


def _single(one: Lens | Element) -> Element:
    """Return the element of a stock lens."""
    if isinstance(one, Element):
        return one
    if len(one.elements) != 1:
        raise ValueError(f"expected a lens of one element, got {one.name} of {len(one.elements)}")
    return one.elements[0]
