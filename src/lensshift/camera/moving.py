"""A camera that runs: the scene cast once, then frames at any offset, in milliseconds each."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from lensshift.camera.cells import World
from lensshift.camera.channels import Seen, Tones
from lensshift.camera.output import Image, image_of
from lensshift.camera.readout import harmonic_shares, read
from lensshift.camera.settings import PlainOptics, TofCamera
from lensshift.camera.simulate import rates_of, true_images
from lensshift.camera.view import View
from lensshift.core.arrays import Array
from lensshift.scene import Scene

REACH_PX = 1.25  # all patterns and the play of a stage


class RunningCamera:
    """A time-of-flight camera before a scene that stands still, for a stream of frames.

    The scene is cast on fine cells and blurred by the lens once; a frame is then the mean over
    the aperture of each pixel, from sums over the cells, which costs the same for every offset.

    Parameters
    ----------
    scene, camera : the world; plain optics, no indirect light
    reach_px : the largest offset along an axis
    samples : cells across an LR pixel

    Raises
    ------
    ValueError
        If the camera has a traced lens or indirect light, which this short cut does not know.
    """

    def __init__(
        self, scene: Scene, camera: TofCamera, *, reach_px: float = REACH_PX, samples: int = 16
    ) -> None:
        from scipy.ndimage import gaussian_filter

        optics = camera.optics
        if not isinstance(optics, PlainOptics) or camera.multipath is not None:
            raise ValueError("expected plain optics and no indirect light for a running camera")
        self.camera, self._samples, self.reach_px = camera, samples, reach_px
        self._tones = Tones(
            camera.illumination.modulation_hz, tuple(harmonic_shares(camera.pixels))
        )
        self._margin = int(np.ceil(samples * (reach_px + 5.0 * optics.blur_sigma_px))) + 1
        rows, cols = (count * samples + 2 * self._margin for count in camera.grid.shape)
        cells = np.empty((rows, cols, self._tones.channels))
        view = View(camera, self._margin / samples + 0.5)
        corners = ((np.arange(n) - self._margin) / samples - 0.5 for n in (rows, cols))
        World(scene, view, self._tones, None, samples).fill(cells, *corners)
        gaussian_filter(cells, samples * optics.blur_sigma_px, axes=(0, 1), output=cells)
        # [channel row col] over all cells above and left
        self._sums = np.zeros((self._tones.channels, rows + 1, cols + 1))
        np.cumsum(np.cumsum(cells.transpose(2, 0, 1), axis=1), axis=2, out=self._sums[:, 1:, 1:])

    def seen(self, offset_px: ArrayLike) -> Seen:
        """Return the means over the pixels, without noise.

        Parameters
        ----------
        offset_px : [2], or [row col 2] where the shift varies over the sensor

        Raises
        ------
        ValueError
            If an offset goes beyond `reach_px`.
        """
        return self._means(1, offset_px, self.camera.pixels.fill_factor**0.5)

    def truth(self, scale: int, offset_px: ArrayLike = (0.0, 0.0)) -> tuple[Array, Array]:
        """Return amplitude and distance [row col] on the HR grid, as `TofTruth` has them.

        Raises
        ------
        ValueError
            As in `seen`.
        """
        return true_images(self._means(scale, offset_px, 1.0 / scale), self.camera)

    def _means(self, scale: int, offset_px: ArrayLike, side_px: float) -> Seen:
        from scipy.ndimage import map_coordinates

        offset = np.asarray(offset_px, dtype=np.float64)
        if not np.all(np.abs(offset) <= self.reach_px):
            raise ValueError(f"expected offsets of at most {self.reach_px} px")
        shape = self.camera.grid.refine(scale).shape
        centre_px = (np.moveaxis(np.indices(shape), 0, -1) + 0.5) / scale - offset
        means = np.zeros((*shape, self._tones.channels))
        for down, right in product((-0.5, 0.5), repeat=2):  # corners of the squares
            corner = (centre_px + side_px * np.array([down, right])) * self._samples + self._margin
            share, place = 4.0 * down * right / side_px**2, np.moveaxis(corner, -1, 0)
            for number, sums in enumerate(self._sums):  # bilinear: cells are even
                means[..., number] += share * map_coordinates(sums, place, order=1)
        return Seen(means / self._samples**2, self._tones)

    def frame(self, offset_px: ArrayLike, rng: np.random.Generator) -> Image:
        """Expose one frame while the image goes through offsets [instant ...], see `seen`.

        Raises
        ------
        ValueError
            As in `seen`.
        """
        instants = [self.seen(offset).values for offset in np.asarray(offset_px)]
        seen = Seen(np.mean(instants, axis=0), self._tones)
        camera = self.camera
        return image_of(read(rates_of(seen, camera, 0), camera.pixels, camera.readout, rng), camera)
