"""The published IRW-SR toolbox, step by step and with its defects.

This is the yardstick, not the method to use: the objective reads the prior weights in another
pixel order than the gradient, the gradient is not the derivative of the objective, and the
magnification climbs 1, 2, .. scale. It shares no code with `lensshift.forward`, so that it can
check it. Vectors are images in row-major pixel order unless a comment says otherwise.

Source: the multi-frame super-resolution code in the SupER benchmark (T. Koehler, MIT licence);
Koehler et al., Robust multiframe super-resolution employing iteratively re-weighted
minimization, IEEE Trans. Comput. Imaging 2 (2016).
"""
