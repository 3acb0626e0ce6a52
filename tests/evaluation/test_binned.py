"""The published binning algorithms, through the public call, against stored outputs of theirs."""

from pathlib import Path

import numpy as np
import pytest

from lensshift.evaluation.slanted_edge import measure_edge

pytestmark = pytest.mark.filterwarnings("ignore::lensshift.core.errors.QualityWarning")


@pytest.mark.parametrize(
    ("prefix", "options"),
    [
        ("sfrmat3", {"method": "sfrmat3"}),
        ("sfrmat5_p5", {"method": "sfrmat5"}),
        ("sfrmat5_p1", {"method": "sfrmat5", "order": 1}),
        ("sfrmat5_p1_hamming", {"method": "sfrmat5", "order": 1, "window": "hamming"}),
    ],
)
@pytest.mark.parametrize(("size", "every"), [("64x16", 12), ("128x32", 20), ("200x200", 11)])
def test_equals_the_published_code(
    reference_dir: Path, size: str, every: int, prefix: str, options: dict[str, object]
) -> None:
    folder = reference_dir / "slanted_edge" / "open"
    images = np.load(folder / f"edges_{size}.npz")["images"]
    stored = np.load(folder / f"edges_{size}_ref.npz")
    finite = [k for k in range(0, len(images), every) if stored[f"{prefix}_finite"][k]]
    assert len(finite) > 2
    rows, cols = images.shape[1:]
    for k in finite:
        found = measure_edge(images[k], region=(0, rows, 0, cols), **options)  # type: ignore[arg-type]
        curve = stored[f"{prefix}_sfr"][k][: found.mtf.modulation.size]
        np.testing.assert_allclose(found.mtf.modulation, curve, atol=1e-6)


def test_what_no_binning_can_do_is_told() -> None:
    row, col = np.mgrid[:16, :64].astype(float)
    image = np.clip(col - 31.0 + 0.035 * row, 0.0, 1.0)
    with pytest.raises(ValueError, match="line"):
        measure_edge(image, method="sfrmat3")
    with pytest.raises(ValueError, match="one image"):
        measure_edge(np.stack([image, image]), offset_px=np.zeros((2, 2)), method="sfrmat5")
    image[3, 4] = np.nan
    with pytest.raises(ValueError, match="1 invalid"):
        measure_edge(image, method="sfrmat5")


def test_lines_across_an_edge_along_the_rows_are_its_columns() -> None:
    """The rows were counted: 16 of them, at 2.5 degrees, leave 0.3 px unsampled, 80 none."""
    row, col = np.mgrid[:16, :80].astype(float)
    level = np.clip(row - 8.2 + np.tan(np.deg2rad(2.5)) * (col - 40.0), 0.0, 1.0)
    found = measure_edge(level, region=(0, 16, 0, 80), method="sfrmat3")
    assert found.orientation == "horizontal"
    assert found.usable
