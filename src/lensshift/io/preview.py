"""A picture that puts images side by side on one grey scale."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from lensshift.io.atomic import written_whole

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL.Image import Image

_READABLE_PX = 640
_LABEL_PX = 28
_GAP_PX = 20
_INK, _PAPER = 0, 255


def write_preview(
    panels: dict[str, NDArray[Any]], path: Path, note: str, *, below: NDArray[Any] | None = None
) -> tuple[float, float]:
    """Draw labelled images of one shape beside (wide ones: below) each other, and a note.

    Black and white are the 0.5 and 99.5 percentiles of all finite pixels; complex images are
    shown by their modulus. Small images are enlarged by a whole factor.

    Parameters
    ----------
    below : a picture [row col 3] in colour to put below them, or None

    Returns
    -------
    The values that became black and white.
    """
    import numpy as np
    from PIL import Image

    from lensshift.io.export import to_grey

    images = {
        label: np.abs(image) if np.iscomplexobj(image) else np.asarray(image, dtype=np.float64)
        for label, image in panels.items()
    }
    pixels = np.concatenate([image[np.isfinite(image)] for image in images.values()])
    low, high = np.percentile(pixels, (0.5, 99.5)).tolist() if pixels.size else (0.0, 0.0)
    rows, cols = next(iter(images.values())).shape
    factor = max(1, _READABLE_PX // max(rows, cols))
    drawn = {
        label: Image.fromarray(np.kron(to_grey(image, low, high), np.ones((factor, factor), "u1")))
        for label, image in images.items()
    }
    sheet = _sheet(drawn, f"{note}  |  black {low:.4g}, white {high:.4g}", stacked=cols > 2 * rows)
    if below is not None:
        sheet = _above(sheet, Image.fromarray(below))
    with written_whole(path) as temporary:
        sheet.save(temporary, format="PNG")
    return low, high


def _above(sheet: Image, picture: Image) -> Image:
    from PIL import Image

    width, height = max(sheet.width, picture.width + 2 * _GAP_PX), sheet.height + _GAP_PX
    both = Image.new("RGB", (width, height + picture.height + _GAP_PX), (_PAPER,) * 3)
    both.paste(sheet, (0, 0))
    both.paste(picture, ((width - picture.width) // 2, height))
    return both


def _sheet(images: dict[str, Image], note: str, *, stacked: bool) -> Image:
    from PIL import Image, ImageDraw, ImageFont

    width, height = next(iter(images.values())).size
    step = (0, height + _LABEL_PX + _GAP_PX) if stacked else (width + _GAP_PX, 0)
    font = ImageFont.load_default(size=16)
    note_width = int(font.getlength(note)) + 2 * _GAP_PX
    last = len(images) - 1
    sheet_width = max(step[0] * last + width + 2 * _GAP_PX, note_width)
    sheet_height = step[1] * last + height + 2 * _LABEL_PX + 2 * _GAP_PX
    sheet = Image.new("L", (sheet_width, sheet_height), _PAPER)
    draw = ImageDraw.Draw(sheet)
    for index, (label, image) in enumerate(images.items()):
        left, top = _GAP_PX + index * step[0], _GAP_PX + index * step[1]
        draw.text((left, top), label, fill=_INK, font=font)
        sheet.paste(image, (left, top + _LABEL_PX))
        if index and stacked:
            draw.line([(0, top - _GAP_PX // 2), (sheet_width, top - _GAP_PX // 2)], fill=_INK)
        elif index:
            middle, bottom = left - _GAP_PX // 2, sheet_height - _LABEL_PX - _GAP_PX // 2
            draw.line([(middle, 0), (middle, bottom)], fill=_INK)
    draw.text((_GAP_PX, sheet_height - _LABEL_PX), note, fill=_INK, font=font)
    return sheet
