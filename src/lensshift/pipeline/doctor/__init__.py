"""What is wrong with a rig, and how well it does."""

from lensshift.pipeline.doctor.examine import Diagnosis, examine_rig
from lensshift.pipeline.doctor.findings import Finding, Level

__all__ = ["Diagnosis", "Finding", "Level", "examine_rig"]
