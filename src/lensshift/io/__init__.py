"""Files and foreign formats to core types and back."""

from lensshift.io.burst_file import load_burst, save_burst
from lensshift.io.result_file import load_reconstruction, save_reconstruction

__all__ = ["load_burst", "load_reconstruction", "save_burst", "save_reconstruction"]
