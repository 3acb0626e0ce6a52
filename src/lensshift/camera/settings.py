"""What a time-of-flight camera is made of: one frozen group of settings per effect.

An effect is off where its group is None or its number is 0; `TofCamera.ideal` turns all off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal

from lensshift.core.grid import Grid
from lensshift.core.units import doubt_about_pitch, doubt_about_units
from lensshift.optics.lens import Lens
from lensshift.scene.checks import number, positive, positives, share

OutputStyle = Literal["float", "o3m"]
OUTPUT_STYLES: tuple[OutputStyle, ...] = ("float", "o3m")
_FASTEST = 0.5  # f-number in air: with less, an image were brighter than what it is of
MOST_BITS = 16  # of a converter, whose numbers go into words
LIGHT_NM = (100.0, 20_000.0)  # that lenses let through and sensors see
MOST_BLUR_PX = 10.0  # of a lens: beyond, the scene is not seen
MOST_KLX = 1000.0  # ten suns


def _not_negative(name: str, value: object) -> None:
    if not number(name, value) >= 0:
        raise ValueError(f"expected {name} of at least 0, got {value}")


@dataclass(frozen=True, slots=True)
class Illumination:
    """The modulated light, which comes from the place of the lens.

    Parameters
    ----------
    modulation_hz : one, or several in whole Hz for a longer range; the truth is of the first one
    intensity_w_per_sr : mean radiant intensity
    wavelength_nm : of the light
    """

    modulation_hz: tuple[float, ...] = (15e6,)
    intensity_w_per_sr: float = 20.0
    wavelength_nm: float = 850.0

    def __post_init__(self) -> None:
        frequencies = positives("modulation_hz", self.modulation_hz)
        if not frequencies or len(set(frequencies)) < len(frequencies):
            raise ValueError(f"expected different modulation_hz, at least one, got {frequencies}")
        doubt = doubt_about_units(min(frequencies), None)
        if doubt:
            raise ValueError(doubt)
        if len(frequencies) > 1 and any(one != int(one) for one in frequencies):
            raise ValueError(f"expected whole Hz for several modulation_hz, got {frequencies}")
        object.__setattr__(self, "modulation_hz", frequencies)
        positive("intensity_w_per_sr", self.intensity_w_per_sr)
        low_nm, high_nm = LIGHT_NM
        if not low_nm <= number("wavelength_nm", self.wavelength_nm) <= high_nm:
            raise ValueError(
                f"expected wavelength_nm from {low_nm:g} to {high_nm:g}, got "
                f"{self.wavelength_nm:g}; 0.85 um are 850"
            )


@dataclass(frozen=True, slots=True)
class PlainOptics:
    """A lens without distortion that moves the whole image by the same amount.

        light(field angle) = cos^4, of a pupil that all directions fill, less what is vignetted

    Parameters
    ----------
    focal_length_mm : from the pinhole to the sensor
    f_number : focal length over diameter of the pupil, at least 0.5
    transmission : share of the light that lens and filter let through
    blur_sigma_px : of the Gaussian that the lens makes of a point; 0: a point
    natural_falloff : whether light falls with the fourth power of the cosine; False: it is even, as
        where the illumination is shaped to make up for it
    vignetting : share of the light that the corners of the sensor lose besides, because a second
        aperture in front of the pupil hides a part of it
    """

    focal_length_mm: float
    f_number: float
    transmission: float = 0.8
    blur_sigma_px: float = 0.0
    natural_falloff: bool = True
    vignetting: float = 0.0

    def __post_init__(self) -> None:
        positive("focal_length_mm", self.focal_length_mm)
        if positive("f_number", self.f_number) < _FASTEST:
            raise ValueError(f"expected f_number of at least {_FASTEST}, got {self.f_number}")
        share("transmission", self.transmission)
        share("vignetting", self.vignetting)
        if not 0 <= number("blur_sigma_px", self.blur_sigma_px) <= MOST_BLUR_PX:
            raise ValueError(
                f"expected blur_sigma_px from 0 to {MOST_BLUR_PX:g} LR pixels, "
                f"got {self.blur_sigma_px:g}"
            )


@dataclass(frozen=True, slots=True)
class LensOptics:
    """A traced lens: distortion, point spread and shift vary over the sensor.

    Everything is imaged as from the object distance of the lens: things nearer or farther are
    not out of focus. The image darkens towards its corners as traced at rest, by the aperture that
    each place sees (natural falloff, vignetting, pupil aberrations); a moving element does not
    change that. The lens is traced in its own light, whatever that of the camera.

    Parameters
    ----------
    lens : at rest
    element : number of the element that moves, counted from 0; None: the lens stays where it is
        and the sensor moves
    transmission : share of the light that lens and filter let through
    diffraction : whether the point spread holds diffraction, beside the aberrations
    """

    lens: Lens
    element: int | None = 0
    transmission: float = 0.8
    diffraction: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.lens, Lens):
            raise TypeError(f"expected a Lens, got {type(self.lens).__name__}")
        if self.element is not None:
            self.lens.check_element(self.element)
        share("transmission", self.transmission)

    @property
    def f_number(self) -> float:
        """Working f-number of the lens at rest."""
        from lensshift.optics.paraxial import paraxial

        return paraxial(self.lens).working_f_number


@dataclass(frozen=True, slots=True)
class Scatter:
    """Light that lens and sensor throw far from where it belongs.

    Parameters
    ----------
    scattered : share of the light
    sigma_px : of the Gaussian over which it is spread, the image mirrored at its borders
    told_error : of the share that a burst tells, as measured: rms error, over the share
    """

    scattered: float = 0.02
    sigma_px: float = 8.0
    told_error: float = 0.1

    def __post_init__(self) -> None:
        share("scattered", self.scattered)
        share("told_error", self.told_error)
        positive("sigma_px", self.sigma_px)


@dataclass(frozen=True, slots=True)
class Pixels:
    """What a pixel makes of light.

        tap A, B = electrons / 2 (1 +- contrast [cos p + h3 cos 3p + h5 cos 5p]),
        p = phase - k pi / 2

    Parameters
    ----------
    fill_factor : share of the area that is sensitive, a square in the middle of the pixel
    quantum_efficiency : electrons per photon
    contrast : of the demodulation
    harmonic_3, harmonic_5 : h3, h5 of the correlation, which make distances wiggle
    dark_electrons_per_s : without light, in both taps together
    """

    fill_factor: float = 1.0
    quantum_efficiency: float = 0.6
    contrast: float = 0.6
    harmonic_3: float = 0.0
    harmonic_5: float = 0.0
    dark_electrons_per_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("fill_factor", "quantum_efficiency", "contrast"):
            if not 0 < number(name, getattr(self, name)) <= 1:
                raise ValueError(f"expected {name} above 0, up to 1, got {getattr(self, name)}")
        _not_negative("dark_electrons_per_s", self.dark_electrons_per_s)
        harmonics = abs(number("harmonic_3", self.harmonic_3))
        harmonics += abs(number("harmonic_5", self.harmonic_5))
        if self.contrast * (1.0 + harmonics) > 1.0:
            raise ValueError(
                f"expected contrast (1 + |harmonic_3| + |harmonic_5|) up to 1, so that no tap goes "
                f"below 0, got {self.contrast * (1.0 + harmonics):.3g}"
            )


@dataclass(frozen=True, slots=True)
class Ambient:
    """Sunlight on the scene, diffuse.

        irradiance = 8.2 mW / (m2 nm klx) * illuminance * filter width

    Parameters
    ----------
    illuminance_klx : 100 to 120 in full sun
    filter_width_nm : of the band-pass in front of the sensor
    """

    illuminance_klx: float
    filter_width_nm: float = 50.0

    def __post_init__(self) -> None:
        _not_negative("illuminance_klx", self.illuminance_klx)
        if self.illuminance_klx > MOST_KLX:
            raise ValueError(
                f"expected illuminance_klx of at most {MOST_KLX:g}, got {self.illuminance_klx:g}; "
                "the sun makes 100, and it is in klx, not lx"
            )
        positive("filter_width_nm", self.filter_width_nm)


@dataclass(frozen=True, slots=True)
class Readout:
    """From electrons to numbers.

    Each pixel uses the longest exposure in which no tap saturates, and the largest gain at which
    no phase leaves the range of the converter.

    Parameters
    ----------
    exposure_s : of each of the four phases, rising
    gain : of the amplifier before the converter, rising
    full_well_electrons : of a tap; also half the range of the converter
    saturates : whether a full tap stays full and makes the pixel invalid
    shot_noise : whether electrons are counted (Poisson) or taken as their mean
    read_noise_electrons : standard deviation of a tap without light
    bits : of the converter for tap A - tap B, sign included; None: it neither rounds nor clips
    background_electrons : up to which equal charge is removed from both taps of each phase
        during the exposure (suppression of background illumination); its shot noise stays
    """

    exposure_s: tuple[float, ...] = (1e-3,)
    gain: tuple[float, ...] = (1.0,)
    full_well_electrons: float = 5e5
    saturates: bool = True
    shot_noise: bool = True
    read_noise_electrons: float = 50.0
    bits: int | None = 12
    background_electrons: float = 0.0

    def __post_init__(self) -> None:
        for name in ("exposure_s", "gain"):
            values = positives(name, getattr(self, name))
            if not values or list(values) != sorted(set(values)):
                raise ValueError(f"expected rising {name}, at least one, got {values}")
            object.__setattr__(self, name, values)
        positive("full_well_electrons", self.full_well_electrons)
        _not_negative("read_noise_electrons", self.read_noise_electrons)
        _not_negative("background_electrons", self.background_electrons)
        if self.bits is not None and not 2 <= self.bits <= MOST_BITS:
            raise ValueError(f"expected 2 to {MOST_BITS} bits, or None, got {self.bits}")


@dataclass(frozen=True, slots=True)
class Multipath:
    """Light that meets two surfaces on its way back to the camera.

    Parameters
    ----------
    patches : rows and columns of equal parts of the field of view that light the rest of the
        scene; what the camera does not see lights nothing
    shadows : whether things between two surfaces block light; without it this is faster
    """

    patches: tuple[int, int] = (8, 16)
    shadows: bool = True

    def __post_init__(self) -> None:
        if len(self.patches) != 2 or min(self.patches) < 1:
            raise ValueError(f"expected patches (rows, cols) of at least 1, got {self.patches}")


@dataclass(frozen=True, slots=True)
class Drift:
    """Distance that is measured too long because the camera is warm.

    Parameters
    ----------
    mm_per_k : distance per kelvin
    temperature_rise_k : since the calibration, in the first frame
    warming_k_per_frame : from each frame to the next
    """

    mm_per_k: float
    temperature_rise_k: float = 0.0
    warming_k_per_frame: float = 0.0

    def __post_init__(self) -> None:
        for name in ("mm_per_k", "temperature_rise_k", "warming_k_per_frame"):
            number(name, getattr(self, name))


@dataclass(frozen=True, slots=True)
class Validity:
    """When a pixel is not to be used, and when it mixes surfaces.

    Parameters
    ----------
    min_amplitude_electrons : a pixel with a smaller demodulated amplitude is invalid
    flying_std_m : a pixel is flying if the distances in it, weighted with their light, have a
        larger standard deviation. Only the truth tells: cameras do not know
    """

    min_amplitude_electrons: float = 0.0
    flying_std_m: float = 0.02

    def __post_init__(self) -> None:
        _not_negative("min_amplitude_electrons", self.min_amplitude_electrons)
        positive("flying_std_m", self.flying_std_m)


@dataclass(frozen=True, slots=True)
class TofCamera:
    """A time-of-flight camera whose image can be shifted.

    Parameters
    ----------
    grid : the LR sampling grid, centred on the optical axis
    optics, illumination, pixels, readout, validity : always there
    ambient, scatter, multipath, drift : effects, off where None
    output : "float": distance and amplitude as computed; "o3m": whole centimetres up to 150 m,
        1 cm where invalid or farther, and 16-bit amplitudes of the exposure and gain that a pixel
        used
    name : for the notes in a burst
    """

    grid: Grid
    optics: PlainOptics | LensOptics
    illumination: Illumination = Illumination()
    pixels: Pixels = Pixels()
    readout: Readout = Readout()
    validity: Validity = Validity()
    ambient: Ambient | None = None
    scatter: Scatter | None = None
    multipath: Multipath | None = None
    drift: Drift | None = None
    output: OutputStyle = "float"
    name: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.optics, PlainOptics | LensOptics):
            kind = type(self.optics).__name__
            raise TypeError(f"expected PlainOptics or LensOptics, got {kind}")
        if self.output not in OUTPUT_STYLES:
            raise ValueError(f"expected one of {', '.join(OUTPUT_STYLES)}, got {self.output!r}")
        if doubt := doubt_about_pitch(max(self.grid.pitch_mm)):
            raise ValueError(doubt)
        if self.output == "o3m" and (self.readout.bits is None or max(self._states) > 2):
            raise ValueError(
                "expected a converter with bits, and up to 2 exposures and 2 gains for output "
                f"'o3m', got bits {self.readout.bits} and {self._states}"
            )

    @property
    def _states(self) -> tuple[int, int]:
        return len(self.readout.exposure_s), len(self.readout.gain)

    def ideal(self) -> TofCamera:
        """Return the camera with the same optics and pixels, without noise and errors."""
        pixels = replace(self.pixels, harmonic_3=0.0, harmonic_5=0.0, dark_electrons_per_s=0.0)
        readout = replace(
            self.readout, saturates=False, shot_noise=False, read_noise_electrons=0.0, bits=None
        )
        return replace(
            self, pixels=pixels, readout=readout, ambient=None, scatter=None, multipath=None,
            drift=None, output="float",
        )  # fmt: skip

    def settings(self) -> Mapping[str, Any]:
        """Return all settings as text and numbers; a lens by its name."""
        groups = {
            name: _plain(getattr(self, name))
            for name in self.__dataclass_fields__
            if name not in ("grid", "output", "name")
        }
        return {"camera": self.name, "output": self.output} | groups


def _plain(group: Any) -> Any:
    if group is None:
        return None
    if isinstance(group, LensOptics):
        from lensshift.optics.spots import marks_of

        told = {one.name: getattr(group, one.name) for one in fields(group)}
        motion = "sensor" if group.element is None else "decentre"
        return told | marks_of(group.lens) | {"lens": group.lens.name, "motion": motion}
    return asdict(group)
