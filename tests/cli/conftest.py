"""A stand-in for the reconstruction, so that the command line is tested alone."""

import sys
import types
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import lensshift
from lensshift.cli.app import app
from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst, Estimate, Reconstruction, Status
from lensshift.io import save_burst

METHODS = ("nearest", "bicubic", "irwsr")
Call = Callable[..., Result]


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
            std=np.ones(image.shape),
            objective=(2.5, 2.0),
            status=Status.CONVERGED,
            prior_weight=0.0125,
            noise_gain=1.25,
        )
        return Reconstruction(
            amplitude=None if channel == "distance" else estimate,
            distance_m=estimate if channel == "distance" else None,
            grid=burst.grid.refine(scale),
            scale=scale,
            method="irwsr" if options["method"] == "auto" else options["method"],
            settings={"psf_sigma_px": options.get("psf_sigma_px"), "inf": np.float64("inf")},
        )


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeReconstruct:
    stand_in = FakeReconstruct()
    methods = types.ModuleType("lensshift.reconstruction.methods")
    methods.method_names = lambda: METHODS  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "lensshift.reconstruction.methods", methods)
    monkeypatch.setattr(lensshift, "reconstruct", stand_in, raising=False)
    return stand_in


@pytest.fixture
def burst() -> Burst:
    rng = np.random.default_rng(0)
    return Burst.from_arrays(
        rng.random((4, 5, 7)),
        rng.random((4, 5, 7)) + 3,
        offset_px=[[0, 0], [0, 0.5], [0.5, 0], [0.5, 0.5]],
        offset_sigma_px=np.full((4, 2), 0.01),
        pitch_mm=(0.15, 0.1),
        modulation_hz=20e6,
        meta={"camera": "simulated"},
    )


@pytest.fixture
def burst_file(burst: Burst, tmp_path: Path) -> Path:
    save_burst(burst, tmp_path / "burst.nc")
    return tmp_path / "burst.nc"


@pytest.fixture
def call() -> Call:
    """Return a function that runs `lensshift` with arguments."""

    def run(*arguments: object) -> Result:
        return CliRunner().invoke(app, [str(argument) for argument in arguments])

    return run
