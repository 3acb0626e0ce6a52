"""A camera and a stage of your own: any function that returns a picture, any object that moves.

    python examples/own_camera.py [FOLDER]

The picture comes from the built-in simulator, moved by what the stage says; put your own here.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import lensshift
from lensshift.camera import RunningCamera, camera_preset
from lensshift.capture.acquire import Acquisition, acquire
from lensshift.capture.drivers.from_callable import CallableCamera
from lensshift.capture.opening import nominal_calibration
from lensshift.capture.plan import named_plan
from lensshift.scene import four_boxes

PX_PER_MM = 5.63


class MyStage:
    """Two axes in mm (row, col); yours would send commands here. No base class is needed."""

    name = "my stage"
    travel_mm = np.array([[0.0, 6.0], [0.0, 6.0]])

    def __init__(self) -> None:
        self._place_mm = np.array([3.0, 3.0])

    def position_mm(self) -> np.ndarray:
        """Say where the stage is."""
        return self._place_mm.copy()

    def move_to(self, position_mm, *, direct: bool = False) -> np.ndarray:
        """Go there; `direct` without caring for play."""
        self._place_mm = np.array(position_mm, dtype=float)
        return self.position_mm()

    def stop(self) -> None:
        """Stand still."""

    def close(self) -> None:
        """Let go of the device."""

    def describe(self) -> dict[str, str]:
        """Say what to keep beside the frames."""
        return {"model": "in memory"}


def main(folder: Path) -> None:
    """Capture a burst into the folder and reconstruct it."""
    stage = MyStage()
    world = RunningCamera(four_boxes(), camera_preset("o3m151"))
    rng = np.random.default_rng(0)

    def grab():
        image = world.frame([PX_PER_MM * (stage.position_mm() - 3.0)], rng)
        return {"amplitude": image.amplitude, "distance_m": image.distance_m, "valid": image.valid}

    camera = CallableCamera(grab, pitch_mm=0.155, name="my camera")
    camera.open()
    try:
        burst = acquire(
            stage,
            camera,
            named_plan("square"),
            nominal_calibration(PX_PER_MM, rest_mm=(3.0, 3.0)),
            folder / "burst.nc",
            Acquisition(frames=2, average=True),
        )
    finally:
        camera.close()
    result = lensshift.reconstruct(burst, scale=2, channel="amplitude")
    print(f"{burst.frame_count} frames, stage at (mm):\n{np.round(burst.stage_mm, 4)}")
    print(f"{result.method} x{result.scale}: {result.grid.shape[0]} x {result.grid.shape[1]} px")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(Path(temporary))
