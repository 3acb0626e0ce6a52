"""The whole chain: the only place that knows the order.

scene -> camera -> burst -> reconstruction -> comparison with the truth -> files and report
"""

from lensshift.pipeline.experiment import Experiment, Outcome, carry_out, demo_burst
from lensshift.pipeline.experiment_file import default_experiment, load_experiment, named_scene
from lensshift.pipeline.run import RunSummary, run

__all__ = [
    "Experiment",
    "Outcome",
    "RunSummary",
    "carry_out",
    "default_experiment",
    "demo_burst",
    "load_experiment",
    "named_scene",
    "run",
]
