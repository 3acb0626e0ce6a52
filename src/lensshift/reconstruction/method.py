"""A method is one frozen dataclass: its settings, their check, its name and its summary."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from lensshift.core.arrays import Floats
from lensshift.core.types import Estimate
from lensshift.reconstruction.noise_law import NoiseLaw
from lensshift.reconstruction.options import check_settings, option, truth, weight, whole
from lensshift.reconstruction.problem import Problem, brightness_of

if TYPE_CHECKING:
    from lensshift.reconstruction.devices import Device

Weight = float | Literal["cross-validation"] | None


@dataclass(frozen=True, slots=True)
class Request:
    """What every method is asked for; the caller's own words for the phasor channel beside it.

    Parameters
    ----------
    prior_weight : a number, None for the automatic choice, or "cross-validation"
    seed : of everything random
    non_negative : whether negative values are forbidden
    std : whether the propagated noise is wanted
    photometric : whether gain and bias of each frame are estimated
    on_iteration : called with the number of the iteration and the objective
    options : settings of the method that the caller gave
    frames : numbers of the frames in the burst
    refuted : what the frames say against the pixel response that was told, or None
    shifts_doubted : whether the shifts were found to be wrong as a whole, and the user was told
    streamed : whether a stream asks, again and again
    law : noise of the light that was read with the response, in units of the burst, or None
    gain : [frequency frame] by which the phasors of the frames were divided, or None
    turn_rad : [frequency frame] by which their phases were turned back, or None
    still_std : deviation of what is left of a fixed pattern of the pixels, in units of the burst
    still_rad : [frequency] the same of a fixed pattern of their phases, or None
    device : where "auto" finds its pictures, or None for the kernels of this processor
    """

    prior_weight: Weight = option(None, weight())
    seed: int = option(0, whole(0))
    non_negative: bool = option(False, truth())
    std: bool = option(True, truth())
    photometric: bool = option(False, truth())
    on_iteration: Callable[[int, float], None] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    frames: Sequence[int] = ()
    refuted: str | None = None
    shifts_doubted: bool = False
    streamed: bool = False
    law: NoiseLaw | None = None
    gain: Floats | None = None
    turn_rad: Floats | None = None
    still_std: float = 0.0
    still_rad: Floats | None = None
    device: Device | None = None

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class Method:
    """A method of reconstruction; the fields of a subclass are its options.

    A field made by `option` has the rule that its values are checked by, here, on the command
    line and in files alike.

    Attributes
    ----------
    name, summary : how it is called, and one line for people who choose
    intensity : what the frames are divided by before
    take_level, keep_outside : as in `make_problem`
    undoes_lens : whether the blur of the lens is taken off as well; else the picture is what pixels
        of 1/scale of the pitch see behind the same lens
    reads_response : whether a pixel response that nobody told is read from the frames; else it is
        the usual one, or there is none in the method
    questions_shifts : whether shifts that the frames contradict are spoken of; a plain method
        stands beside a solver, which does
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    intensity: ClassVar[Callable[..., float]] = staticmethod(brightness_of)
    take_level: ClassVar[bool] = True
    keep_outside: ClassVar[bool] = False
    undoes_lens: ClassVar[bool] = True
    reads_response: ClassVar[bool] = True
    questions_shifts: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_settings(self)

    def __call__(self, problem: Problem, request: Request) -> Estimate:
        """Return the estimate in units of the problem's intensity."""
        raise NotImplementedError

    @classmethod
    def option_names(cls) -> tuple[str, ...]:
        """Return the names of its options."""
        return tuple(one.name for one in fields(cls))

    @property
    def settings(self) -> dict[str, Any]:
        """Its options by name, with their values."""
        return {name: getattr(self, name) for name in self.option_names()}
