"""Super-resolution for cameras whose lens moves a fraction of a pixel between frames."""
