"""GenICam 3D cameras (Basler blaze, Lucid Helios and others) through harvesters.

Written from the documentation of harvesters; tried with a stand-in only, not with a camera.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lensshift.capture.drivers.from_callable import CallableCamera
from lensshift.core.arrays import Array
from lensshift.core.errors import DataError, DeviceError, of_extra
from lensshift.core.units import MILLIMETRE_M

_AMPLITUDES = ("Mono16", "Mono8")
_RANGE = "Coord3D_C16"
_POINTS = "Coord3D_ABC32f"
_CONFIDENCES = ("Confidence16", "Confidence8")


class GenicamCamera(CallableCamera):
    """One GenICam camera: range as Coord3D_C16 or Coord3D_ABC32f, light as Mono16 or Mono8."""

    def __init__(
        self,
        producer: str = "",  # path of the vendor's GenTL producer, a .cti file
        *,
        pitch_mm: float | tuple[float, float],  # pixel pitch, one number or (row, col)
        index: int = 0,  # which of the cameras that the producer finds
        modulation_hz: float | None = None,  # modulation frequency, if known
        timeout_s: float = 5.0,  # for one buffer
        harvester: Any = None,  # a `Harvester` that is set up already, instead of `producer`
    ) -> None:
        self._harvester = _harvester(producer) if harvester is None else harvester
        self._own = harvester is None
        self._index = index
        self._timeout_s = timeout_s
        self._camera: Any = None
        self._step_m = MILLIMETRE_M
        super().__init__(
            self._fetch,
            pitch_mm=pitch_mm,
            name=f"GenICam camera {index}",
            rate_hz=1000.0,  # the camera sets the pace
            modulation_hz=modulation_hz,
            about={"producer": producer},
        )

    def open(self) -> None:
        """Start the camera and begin to receive. DeviceError if there is no such camera."""
        found = len(self._harvester.device_info_list)
        if not 0 <= self._index < found:
            raise DeviceError(f"the producer finds {found} cameras", device=self.name)
        if self._camera is None:
            self._camera = self._harvester.create(self._index)
            nodes = self._camera.remote_device.node_map
            scale = getattr(nodes, "Scan3dCoordinateScale", None)
            self._step_m = MILLIMETRE_M * (1.0 if scale is None else float(scale.value))
            self._camera.start()
        super().open()

    def _fetch(self) -> dict[str, Any]:
        with self._camera.fetch(timeout=self._timeout_s) as buffer:
            return read_components(buffer.payload.components, self._step_m)

    def close(self) -> None:
        """Stop the camera; a second call does nothing."""
        super().close()
        if self._camera is not None:
            self._camera.stop()
            self._camera.destroy()
            self._camera = None
            if self._own:
                self._harvester.reset()


def _harvester(producer: str) -> Any:
    needed = "GenICam cameras need harvesters: pip install 'lensshift[genicam]'"
    harvester = of_extra("harvesters.core", needed).Harvester()
    harvester.add_file(producer)
    harvester.update()
    return harvester


def read_components(components: Any, step_m: float = MILLIMETRE_M) -> dict[str, Any]:
    """Return amplitude, distance_m and valid from the components of a buffer.

    A count of range is `step_m`; points are in millimetres, their distance is radial. A range or
    confidence of zero is invalid. DataError if there is no intensity, or a component is too short.
    """
    parts = {str(one.data_format): one for one in components}
    name = next((one for one in _AMPLITUDES if one in parts), None)
    if name is None:
        raise DataError(f"expected a component Mono16, got {sorted(parts)}; enable Intensity")
    found: dict[str, Any] = {"amplitude": _pixels(parts[name])}
    valid = np.ones(found["amplitude"].shape, dtype=np.bool_)
    if _POINTS in parts:
        points_m = _pixels(parts[_POINTS], 3).astype(np.float64) * MILLIMETRE_M
        found["distance_m"] = np.linalg.norm(points_m, axis=2)
    elif _RANGE in parts:
        found["distance_m"] = _pixels(parts[_RANGE]) * step_m
    if "distance_m" in found:
        valid &= found["distance_m"] > 0
    for confidence in _CONFIDENCES:
        if confidence in parts:
            valid &= _pixels(parts[confidence]) > 0
    return {**found, "valid": valid}


def _pixels(component: Any, depth: int = 1) -> Array:
    rows, cols = int(component.height), int(component.width)
    values = np.asarray(component.data).ravel()
    if values.size != rows * cols * depth:
        raise DataError(
            f"{values.size} values do not fill {rows} x {cols} pixels",
            field=str(component.data_format),
        )
    return values.reshape((rows, cols, 3) if depth == 3 else (rows, cols))
