"""Several starting forms: never worse than one, better where the one leads nowhere."""

import pytest

from lensshift.core.grid import Grid
from lensshift.optics.lens import Element, Lens, Stop, Surface
from lensshift.optics.refine import merit, refine
from lensshift.optics.starts import refine_from_several
from lensshift.optics.task import Task
from lensshift.optics.variables import Freedom

# Two lenses of which the first is bent the wrong way: downhill their edges stay too thin.
PAIR = Lens(
    tuple(Element((Surface(a), Surface(b)), ("N-SF11",), (2.0,)) for a, b in ((8, 30), (20, -12))),
    (4.0, 5.0), Stop(4.0, 3.0), wavelength_nm=940.0,
)  # fmt: skip
TASK = Task(Grid((120, 160), (0.02, 0.02)), 9.0, 2.0, shares=(0.0, 0.7, 1.0))
FREE = Freedom(thicknesses=True, stop=True)


@pytest.mark.slow
def test_random_forms_find_a_better_place() -> None:
    whole, ways = Task(TASK.grid, 9.0, 2.0), {"grow": (0.4, 0.7, 1.0), "steps": 40}
    alone = merit(refine(PAIR, whole, FREE, **ways), whole, FREE)  # type: ignore[arg-type]
    found = refine_from_several(PAIR, whole, FREE, starts=12, **ways)  # type: ignore[arg-type]
    assert merit(found, whole, FREE) < 0.5 * alone


@pytest.mark.slow
def test_never_worse_and_the_same_again() -> None:
    alone = merit(refine(PAIR, TASK, FREE, steps=6), TASK, FREE)
    told: list[tuple[int, int]] = []
    found, again = (
        refine_from_several(
            PAIR, TASK, FREE, starts=3, steps=6, on_progress=lambda *step: told.append(step)
        )
        for _ in range(2)
    )
    assert found == again
    assert merit(found, TASK, FREE) <= alone
    half = told[: len(told) // 2]
    assert half == [(done, 5) for done in range(1, 6)]


@pytest.mark.filterwarnings("ignore:the lens found is not the one")  # three steps are too few
def test_one_start_is_the_form_itself() -> None:
    one = refine_from_several(PAIR, TASK, FREE, starts=1, steps=3)
    assert one == refine(PAIR, TASK, FREE, steps=3)
    with pytest.raises(ValueError, match="at least one starting form, got 0"):
        refine_from_several(PAIR, TASK, FREE, starts=0)
