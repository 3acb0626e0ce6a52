"""Plain methods: interpolation, deconvolution, shift-and-add, drizzle.

All of them take real or complex frames with any shifts, leave pixels of weight 0 out whatever
their value, and follow the half-pixel rule of `core.grid`: HR pixel i of the reference is seen
by frame k at LR position (i + 1/2) / scale - 1/2 + offset_px[k].
"""
