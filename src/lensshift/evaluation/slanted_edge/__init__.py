"""The MTF from slanted edges: maximum likelihood by default, the published algorithms beside it."""

from lensshift.evaluation.slanted_edge.measure import (
    METHODS,
    measure_edge,
    measure_edges,
    slanted_edge_mtf,
)
from lensshift.evaluation.slanted_edge.regions import find_regions
from lensshift.evaluation.slanted_edge.result import (
    EdgeResult,
    Interval,
    Profile,
    Region,
    average_curves,
    average_interval,
    usable_edges,
)

__all__ = [
    "METHODS", "EdgeResult", "Interval", "Profile", "Region", "average_curves", "average_interval",
    "find_regions", "measure_edge", "measure_edges", "slanted_edge_mtf", "usable_edges",
]  # fmt: skip
