"""Fixtures that several test folders share."""

import os
from pathlib import Path

import pytest

REFERENCE_VARIABLE = "LENSSHIFT_REFERENCE"


@pytest.fixture(scope="session")
def reference_dir() -> Path:
    """Return the folder of reference data; skip the test where there is none."""
    beside_the_repository = Path(__file__).resolve().parents[2] / "shared" / "reference"
    folder = Path(os.environ.get(REFERENCE_VARIABLE, beside_the_repository))
    if not folder.is_dir():
        pytest.skip(f"no reference data; set {REFERENCE_VARIABLE} to the folder that holds them")
    return folder
