"""Cameras to begin with."""

from __future__ import annotations

from lensshift.camera import settings
from lensshift.core.grid import Grid


def preset_names() -> tuple[str, ...]:
    """Return the names that `camera_preset` knows."""
    return tuple(_PRESETS)


def camera_preset(name: str) -> settings.TofCamera:
    """Return a camera to begin with; change it with `dataclasses.replace`.

    Size, optics and output follow published data as far as there are any. Light, full well,
    exposures and noise are assumed, such that distances have the noise that such cameras show.

    Raises
    ------
    ValueError
        If there is no such camera.
    """
    if name not in _PRESETS:
        raise ValueError(f"expected a camera of {', '.join(_PRESETS)}, got {name!r}")
    return _PRESETS[name]


# 64 x 16 pixels behind the lens of 42.7 mm; two exposures, two gains, whole centimetres. The pixels
# of the real camera suppress sunlight up to 120 klx; its modulation frequencies and the sensitive
# share of its pixels are not published.
_O3M151 = settings.TofCamera(
    grid=Grid((16, 64), (0.155, 0.155)),
    optics=settings.PlainOptics(focal_length_mm=42.7, f_number=2.1, blur_sigma_px=0.05),
    illumination=settings.Illumination((15e6,), intensity_w_per_sr=20.0),
    pixels=settings.Pixels(fill_factor=0.5),
    readout=settings.Readout(exposure_s=(5e-5, 4e-4), gain=(1.0, 4.0), background_electrons=2e7),
    validity=settings.Validity(min_amplitude_electrons=300.0),
    scatter=settings.Scatter(0.01),
    output="o3m",
    name="o3m151",
)
# 176 x 132 pixels, 60 x 45 degrees, three frequencies: 150 m without ambiguity.
_PMD_176X132 = settings.TofCamera(
    grid=Grid((132, 176), (0.03, 0.03)),
    optics=settings.PlainOptics(focal_length_mm=4.57, f_number=1.4, blur_sigma_px=0.2),
    illumination=settings.Illumination((30e6, 29e6, 28e6), intensity_w_per_sr=2.0),
    pixels=settings.Pixels(fill_factor=0.6),
    readout=settings.Readout(full_well_electrons=2e5, background_electrons=2e6),
    validity=settings.Validity(min_amplitude_electrons=100.0),
    scatter=settings.Scatter(0.02, 12.0),
    name="pmd_176x132",
)
# 640 x 480 small pixels, 70 degrees wide, two frequencies: 7.5 m without ambiguity.
_VGA = settings.TofCamera(
    grid=Grid((480, 640), (0.007, 0.007)),
    optics=settings.PlainOptics(focal_length_mm=3.2, f_number=1.2, blur_sigma_px=0.3),
    illumination=settings.Illumination((100e6, 20e6), intensity_w_per_sr=3.0),
    pixels=settings.Pixels(fill_factor=0.9, quantum_efficiency=0.4, contrast=0.8),
    readout=settings.Readout(
        full_well_electrons=1e5, read_noise_electrons=20.0, background_electrons=1e6
    ),
    validity=settings.Validity(min_amplitude_electrons=50.0),
    scatter=settings.Scatter(0.02, 30.0),
    name="vga",
)
_PRESETS = {one.name: one for one in (_O3M151, _PMD_176X132, _VGA)}
