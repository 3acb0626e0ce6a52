"""The paper on lens-shift super-resolution, experiment by experiment."""

from lensshift.pipeline.paper.claims import Claim
from lensshift.pipeline.paper.reproduce import Reproduction, reproduce

__all__ = ["Claim", "Reproduction", "reproduce"]
