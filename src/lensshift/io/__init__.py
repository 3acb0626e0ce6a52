"""Files and foreign formats to core types and back."""

from lensshift.io.burst_file import load_burst, open_recording, save_burst, write_recording
from lensshift.io.export import export_burst, export_image, export_reconstruction
from lensshift.io.image_stack import load_image_stack
from lensshift.io.lens_field_file import load_lens_field, save_lens_field
from lensshift.io.offset_table import OffsetTable, load_offsets
from lensshift.io.picture_layers import napari_layers, picture_layers
from lensshift.io.point_cloud_file import save_point_cloud
from lensshift.io.reading import memory_limit
from lensshift.io.result_file import load_reconstruction, save_reconstruction
from lensshift.io.sequence_file import load_window

__all__ = [
    "OffsetTable", "export_burst", "export_image", "export_reconstruction", "load_burst",
    "load_image_stack", "load_lens_field", "load_offsets", "load_reconstruction", "load_window",
    "memory_limit", "napari_layers", "open_recording", "picture_layers", "save_burst",
    "save_lens_field", "save_point_cloud", "save_reconstruction", "write_recording",
]  # fmt: skip
