"""Fixtures that several test folders share."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# Times mean nothing on a shared machine, and the first call of a kernel compiles it.
settings.register_profile("lensshift", deadline=None, max_examples=20)
settings.load_profile("lensshift")

REFERENCE_VARIABLE = "LENSSHIFT_REFERENCE"


@pytest.fixture(scope="session")
def reference_dir() -> Path:
    """Return the folder of reference data; skip the test where there is none."""
    beside_the_repository = Path(__file__).resolve().parents[2] / "shared" / "reference"
    folder = Path(os.environ.get(REFERENCE_VARIABLE, beside_the_repository))
    if not folder.is_dir():
        pytest.skip(f"no reference data; set {REFERENCE_VARIABLE} to the folder that holds them")
    return folder
