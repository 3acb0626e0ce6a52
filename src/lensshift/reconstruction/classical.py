"""The methods that minimise a data loss and a prior: choices of both on the one loop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Literal

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.types import Estimate
from lensshift.reconstruction.losses import (
    LEAST_SIGMA,
    LOSSES,
    Absolute,
    Confidences,
    Loss,
    Squares,
)
from lensshift.reconstruction.method import Method, Request, Weight
from lensshift.reconstruction.options import one_of, option, positive, weight, whole
from lensshift.reconstruction.priors import PRIORS, BilateralTotalVariation, SparseDifferences
from lensshift.reconstruction.problem import Problem, peak_of
from lensshift.reconstruction.selection import cross_validate, predicting_weight, prior_share
from lensshift.reconstruction.solver import MaximumAPosteriori, Reweighted
from lensshift.reconstruction.uncertainty import PropagatedStd


@dataclass(frozen=True, slots=True)
class _Penalised(Method):
    """What these methods share: the way from a problem to an estimate."""

    prior_weight: Weight = option(None, weight())

    def __call__(self, problem: Problem, request: Request) -> Estimate:
        """Return the estimate, at the weight of the prior that is given or found."""
        fit, sigma = self._fit(problem, request)
        chosen = self.prior_weight
        if chosen == "cross-validation":
            chosen = cross_validate(
                lambda value, part: self._run(
                    replace(fit, prior_weight=value), replace(problem, weight=part)
                ).image,
                problem.model.operator, problem.y, problem.weight, request.seed,
                request.on_iteration,
            )  # fmt: skip
        elif chosen is None:
            chosen = self._found(fit, problem, request.seed)
        fit = replace(fit, prior_weight=chosen)
        found = self._run(fit, problem, on_iteration=request.on_iteration)
        image = np.asarray(found.image, np.result_type(found.image, np.float64))
        if request.non_negative:
            image = np.maximum(image, 0.0)
        estimate = replace(found, image=image, noise_sigma=sigma or found.noise_sigma)
        if not request.std:
            return estimate
        std = PropagatedStd(
            partial(self._image, fit, problem), problem.y, problem.weight,
            estimate.noise_sigma or 0.0, request.seed,
        )  # fmt: skip
        return replace(estimate, uncertainty=std)

    def _fit(self, problem: Problem, request: Request) -> tuple[Reweighted, float | None]:
        """Return what is minimised, and the noise of an LR pixel; None: that of the residual."""
        raise NotImplementedError

    def _found(self, fit: Reweighted, problem: Problem, seed: int) -> float:
        """Find the weight: as the prior would have it, or the frames where they tell better."""
        shown, weight = problem.shown_noise, problem.telling_weight
        squares = isinstance(fit.loss, Squares)
        if not squares:  # squares feel the outliers, the other losses hardly do
            weight = np.where(shown.inlier, weight, 0.0)
        shows = max(shown.total if squares else shown.effective, LEAST_SIGMA)
        felt = problem.told or shows
        size = felt if isinstance(fit.loss, Absolute) else 2.0 * felt**2
        rule = MaximumAPosteriori(size * prior_share(problem.blur_sigma_px * problem.scale))
        most = self._run(replace(fit, prior_weight=rule), problem).prior_weight or 0.0
        shows *= float(np.sqrt(np.mean(weight[weight > 0])))

        def solve(value: float, y: Array) -> Array:
            return self._image(replace(fit, prior_weight=value), problem, y)

        sigma = max(felt, shows)  # errors of the model are no scene
        return predicting_weight(
            solve, problem.model.operator, problem.y, weight, most, sigma, seed
        )

    def _arrays(self, problem: Problem) -> tuple[Array, Array]:
        """Return frames and weights in the precision to compute in."""
        return problem.y, problem.weight

    def _start(self, problem: Problem, y: Array, w: Array) -> Array | None:
        return None

    def _image(self, fit: Reweighted, problem: Problem, y: Array) -> Array:
        """Return the picture of other frames."""
        return self._run(fit, replace(problem, y=y)).image

    def _run(self, fit: Reweighted, problem: Problem, **more: Any) -> Estimate:
        y, w = self._arrays(problem)
        x0 = more.pop("x0", None)
        x0 = self._start(problem, y, w) if x0 is None else x0
        return fit(problem.model.operator, y, w, x0, **more)


@dataclass(frozen=True, slots=True)
class _Sparse(_Penalised):
    """Least squares with differences to a power; real and complex frames."""

    def _sparse(
        self, problem: Problem, request: Request, exponent: float, iterations: int, inner: int
    ) -> tuple[Reweighted, float | None]:
        told = felt = problem.told
        if felt is None:
            noise = problem.shown_noise
            # Squares feel the outliers.
            told, felt = max(noise.sigma, LEAST_SIGMA), max(noise.total, LEAST_SIGMA)
        fit = Reweighted(
            Squares(), SparseDifferences(exponent), 1.0, noise_sigma=felt, iterations=iterations,
            inner_iterations=inner, tolerance=2e-4, non_negative=request.non_negative,
        )  # fmt: skip
        return fit, told


@dataclass(frozen=True, slots=True)
class Tikhonov(_Sparse):
    """Squared differences: one linear solve at the weight that it settles on.

        min_x  |A x - y|^2 + weight |D x|^2

    Parameters
    ----------
    prior_weight : weight of the prior; None: found from the noise; "cross-validation": by what
        predicts left-out pixels best
    """

    name: ClassVar[str] = "tikhonov"
    summary: ClassVar[str] = "least squares with squared neighbour differences; linear"

    def _fit(self, problem: Problem, request: Request) -> tuple[Reweighted, float | None]:
        return self._sparse(problem, request, 2.0, 16, 40)


@dataclass(frozen=True, slots=True)
class Tv(_Sparse):
    """Total variation.

        min_x  |A x - y|^2 + weight |D x|_1

    Parameters
    ----------
    prior_weight : weight of the prior; None: found from the noise; "cross-validation": by what
        predicts left-out pixels best
    iterations : largest number of reweightings
    """

    iterations: int = option(16, whole(1))
    name: ClassVar[str] = "tv"
    summary: ClassVar[str] = "least squares with total variation over eight neighbours"

    def _fit(self, problem: Problem, request: Request) -> tuple[Reweighted, float | None]:
        return self._sparse(problem, request, 1.0, self.iterations, 10)


@dataclass(frozen=True, slots=True)
class _Robust(_Penalised):
    """Losses that outliers do not carry away, and priors of degree 1; real frames."""

    def __call__(self, problem: Problem, request: Request) -> Estimate:
        """Return the estimate; see `_Penalised`."""
        if problem.y.dtype.kind == "c":
            raise ValueError(
                f"{self.name} expects real frames; use tikhonov, tv or auto for phasors"
            )
        return super(_Robust, self).__call__(problem, request)


@dataclass(frozen=True, slots=True)
class L1Btv(_Robust):
    """Farsiu's L1 data term with bilateral total variation.

        min_x  |A x - y|_1 + weight sum_{l, m} alpha^(|l| + |m|) |x - S^(l, m) x|_1

    Parameters
    ----------
    prior_weight : weight of the prior; None: found from the noise; "cross-validation": by what
        predicts left-out pixels best
    window : largest step l, m in HR pixels
    alpha : how fast the weight falls with the step
    iterations : largest number of reweightings

    Source: Farsiu et al. 2004, doi 10.1109/TIP.2004.834669.
    """

    window: int = option(2, whole(1))
    alpha: float = option(0.7, positive(1.0))
    iterations: int = option(20, whole(1))
    name: ClassVar[str] = "l1-btv"
    summary: ClassVar[str] = "Farsiu: L1 data term and bilateral total variation"

    def _fit(self, problem: Problem, request: Request) -> tuple[Reweighted, float | None]:
        prior = BilateralTotalVariation(self.window, self.alpha)
        fit = Reweighted(Absolute(), prior, 1.0, iterations=self.iterations)
        return fit, problem.told


# What the priors of `map` can be told.
_OF_PRIOR = {"tv": (), "huber": ("threshold",), "btv": ("window", "alpha")}


@dataclass(frozen=True, slots=True)
class MaximumPosterior(_Robust):
    """A data term and a prior of the caller's choice.

    Parameters
    ----------
    prior_weight : weight of the prior; None: found from the noise; "cross-validation": by what
        predicts left-out pixels best
    prior : "tv", "huber" or "btv" (bilateral total variation)
    data_term : "l2", "l1" or "huber"
    window, alpha : of btv alone, as in `L1Btv`; None: its default
    threshold : of huber alone: differences up to it are squared; None: its default
    iterations : largest number of reweightings
    """

    prior: Literal["tv", "huber", "btv"] = option("tv", one_of(*PRIORS))
    data_term: Literal["l2", "l1", "huber"] = option("l2", one_of(*LOSSES))
    window: int | None = option(None, whole(1))
    alpha: float | None = option(None, positive(1.0))
    threshold: float | None = option(None, positive())
    iterations: int = option(20, whole(1))
    name: ClassVar[str] = "map"
    summary: ClassVar[str] = (
        "maximum a posteriori: prior tv, huber or btv, data_term l2, l1 or huber"
    )

    def __post_init__(self) -> None:
        super(MaximumPosterior, self).__post_init__()
        told = {n for names in _OF_PRIOR.values() for n in names if getattr(self, n) is not None}
        if idle := sorted(told - set(_OF_PRIOR[self.prior])):
            raise ValueError(f"prior {self.prior} does not know {', '.join(idle)}")

    def _fit(self, problem: Problem, request: Request) -> tuple[Reweighted, float | None]:
        told = {name: getattr(self, name) for name in _OF_PRIOR[self.prior]}
        prior = PRIORS[self.prior](**{name: v for name, v in told.items() if v is not None})
        loss: Loss = LOSSES[self.data_term]()
        return Reweighted(loss, prior, 1.0, iterations=self.iterations), problem.told


@dataclass(frozen=True, slots=True)
class Irwsr(_Robust):
    """Reweighted minimisation with confidences and sparse bilateral total variation.

    Against the published toolbox: one objective and its true gradient, weights of the prior that
    do not jump, a start at the final scale, any shifts, shift fields; in single precision.

    Parameters
    ----------
    prior_weight : weight of the prior; None: found from the noise; "cross-validation": by what
        predicts left-out pixels best
    window, alpha : of bilateral total variation, as in `L1Btv`
    sparsity : exponent p of the differences, 1 is total variation, less keeps edges more
    iterations : largest number of reweightings
    inner_iterations : steps of conjugate gradients in each

    Source: Koehler et al. 2016, doi 10.1109/TCI.2016.2516909; toolbox of 2017.
    """

    window: int = option(1, whole(1))
    alpha: float = option(0.5, positive(1.0))
    sparsity: float = option(0.5, positive(1.0))
    iterations: int = option(10, whole(1))
    inner_iterations: int = option(5, whole(1))
    name: ClassVar[str] = "irwsr"
    summary: ClassVar[str] = (
        "iteratively reweighted minimisation (Koehler), corrected, at the final scale"
    )

    def _fit(self, problem: Problem, request: Request) -> tuple[Reweighted, float | None]:
        prior = BilateralTotalVariation(self.window, self.alpha, sparsity=self.sparsity)
        fit = Reweighted(
            Confidences(), prior, 1.0, iterations=self.iterations,
            inner_iterations=self.inner_iterations, solved=0.0,
        )  # fmt: skip
        return fit, problem.told

    def _arrays(self, problem: Problem) -> tuple[Array, Array]:
        return problem.y.astype(np.float32), problem.weight.astype(np.float32)

    def _start(self, problem: Problem, y: Array, w: Array) -> Array:
        """Return A^T W y / A^T w, and the mean of the frames where an HR pixel is hardly seen."""
        A = problem.model.operator
        seen, total = A.adjoint(w), A.adjoint(w * y)
        known = seen > 1e-3 * seen.max()
        mean = total.sum() / max(float(seen.sum()), 1e-30)
        return np.where(known, total / np.where(known, seen, 1), mean).astype(y.dtype)


@dataclass(frozen=True, slots=True)
class IrwsrToolbox(Irwsr):
    """The published toolbox step by step, its defects included.

    Parameters
    ----------
    prior_weight : weight of the prior; None and "cross-validation": its own search
    window, alpha, sparsity, iterations, inner_iterations : as in `Irwsr`

    Source: Koehler et al. 2016, doi 10.1109/TCI.2016.2516909; toolbox of 2017.
    """

    name: ClassVar[str] = "irwsr-toolbox"
    summary: ClassVar[str] = "the published toolbox step by step, its defects included"
    intensity: ClassVar[Any] = staticmethod(peak_of)
    take_level: ClassVar[bool] = False
    keep_outside: ClassVar[bool] = True
    reads_response: ClassVar[bool] = False  # published with a width that is told

    def __call__(self, problem: Problem, request: Request) -> Estimate:
        """Return what the toolbox finds."""
        from lensshift.reconstruction.toolbox.irwsr import irwsr_toolbox

        if request.non_negative:
            raise ValueError("the published toolbox has no non-negative option; use irwsr")
        if problem.noise_sigma is not None:
            raise ValueError(
                "the published toolbox finds its own noise, got noise_sigma; use irwsr"
            )
        if problem.model.offset_px is None:
            raise ValueError(
                "irwsr-toolbox takes one offset per frame, got a shift field; use irwsr"
            )
        positive().check("psf_sigma_px", problem.blur_sigma_px)
        if problem.y.dtype.kind == "c":
            kind = problem.y.dtype
            raise ValueError(f"the toolbox works on real frames only, got dtype {kind}")
        callback, settings = request.on_iteration, self.settings
        if settings["prior_weight"] == "cross-validation":
            settings["prior_weight"] = None  # its only way to find one
        return irwsr_toolbox(
            problem.y, problem.model.offset_px, problem.scale, problem.blur_sigma_px,
            seed=request.seed, confidence=problem.weight,
            on_iteration=None if callback is None else lambda step, _: callback(step, np.nan),
            **settings,
        )[0]  # fmt: skip
