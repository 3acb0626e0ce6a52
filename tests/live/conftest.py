"""What the tests of the live page share."""

import pytest
from serving import taken

from lensshift import Burst


@pytest.fixture(scope="session")
def burst() -> Burst:
    """Four small frames with distances, which say where they look."""
    return taken()
