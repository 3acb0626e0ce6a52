"""What the world does to an image before anybody can estimate anything from it."""

from lensshift.camera.flat import (
    QUARTER_SQUARE_PX,
    Sensor,
    Truth,
    pixel_means,
    simulate_burst,
)

__all__ = ["QUARTER_SQUARE_PX", "Sensor", "Truth", "pixel_means", "simulate_burst"]
