"""How large a pixel is, as TIFF files of microscopes, ImageJ and this package say it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from lensshift.io.image_file import TIFF_SUFFIXES, strict_tifffile
from lensshift.io.reading import reading

SOFTWARE = "lensshift"
_MM = {
    "nm": 1e-6, "um": 1e-3, "micron": 1e-3, "microns": 1e-3, "\u00b5m": 1e-3, "\u03bcm": 1e-3,
    "mm": 1.0, "cm": 10.0, "inch": 25.4, "in": 25.4, "m": 1e3,
}  # fmt: skip


def pixel_size_mm(path: str | Path) -> tuple[float, float] | None:
    """Return the pixel size (row, col) in mm, or None where no file of a known origin tells it.

    The resolution of other files is that of a printer or a screen, 72 or 96 to the inch. DataError
    if what tells it is damaged.
    """
    import tifffile

    if Path(path).suffix.lower() not in TIFF_SUFFIXES:
        return None
    with reading(path), strict_tifffile(), tifffile.TiffFile(path) as file:
        if file.ome_metadata:
            found = _of_ome(file.ome_metadata)
        else:
            told = (file.imagej_metadata or {}).get("unit", "")
            unit = str(told).encode().decode("unicode_escape") if "\\u" in str(told) else str(told)
            tags = file.pages.first.tags
            if tags.valueof("Software") == SOFTWARE and not unit:
                in_cm = tags.valueof("ResolutionUnit") == tifffile.RESUNIT.CENTIMETER
                unit = "cm" if in_cm else ""
            found = _of_tags(tags, _MM.get(unit.strip().lower()))
    return found if found and all(0 < size < 1e6 for size in found) else None


def _of_ome(xml: str) -> tuple[float, float] | None:
    sizes = []
    for axis in "YX":
        size = re.search(rf'PhysicalSize{axis}="([0-9.eE+-]{{1,40}})"', xml)
        unit = re.search(rf'PhysicalSize{axis}Unit="([^"]{{1,20}})"', xml)
        factor = _MM.get(unit[1].strip().lower()) if unit else 1e-3  # micrometres by default
        if size is None or factor is None:
            return None
        sizes.append(float(size[1]) * factor)
    return sizes[0], sizes[1]


def _of_tags(tags: Any, unit_mm: float | None) -> tuple[float, float] | None:
    ratios = [tags.valueof(f"{axis}Resolution") for axis in "YX"]
    if unit_mm is None or not all(ratio and ratio[0] and ratio[1] for ratio in ratios):
        return None
    sizes = [unit_mm * ratio[1] / ratio[0] for ratio in ratios]
    return sizes[0], sizes[1]
