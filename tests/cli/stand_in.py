"""A stand-in for the reconstruction, so that the command line is tested alone."""

import json
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from typer.testing import Result

from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst, Estimate, Reconstruction, Status

Call = Callable[..., Result]
Refused = Callable[[Sequence[object], int, str], None]


def answer(call: Call, *arguments: object) -> dict[str, Any]:
    """Return what a verb hands back with --json."""
    done = call(*arguments, "--json")
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads(done.stdout)
    return found


class FakeReconstruct:
    """Enlarges the first frame and remembers how it was called."""

    def __init__(self) -> None:
        self.calls: list[dict[str, Any]] = []
        self.error: BaseException | None = None
        self.warning = ""

    def __call__(self, burst: Burst, **options: Any) -> Reconstruction:
        self.calls.append(options)
        if self.error is not None and options["method"] != "bicubic":
            raise self.error
        if self.warning:
            warnings.warn(self.warning, QualityWarning, stacklevel=1)
        scale, channel = options["scale"], options["channel"]
        if "on_iteration" in options:
            options["on_iteration"](1, 2.5)
        source = burst.distance_m if channel == "distance" else burst.amplitude
        assert source is not None
        image = np.kron(source[0], np.ones((scale, scale)))
        estimate = Estimate(
            image=image,
            uncertainty=np.full(image.shape, 1.25),
            objective=(2.5, 2.0),
            status=Status.CONVERGED,
            prior_weight=0.0125,
            noise_sigma=1.0,
        )
        return Reconstruction(
            amplitude=None if channel == "distance" else estimate,
            distance_m=estimate if channel == "distance" else None,
            grid=burst.grid.refine(scale),
            scale=scale,
            method="irwsr" if options["method"] == "auto" else options["method"],
            intrinsics=None if burst.intrinsics is None else burst.intrinsics.refine(scale),
            settings={"psf_sigma_px": options.get("psf_sigma_px"), "inf": np.float64("inf")},
        )
