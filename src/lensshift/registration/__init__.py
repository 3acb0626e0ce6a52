"""Where the frames lie: shifts from the frames themselves, and what a scan says of the rig."""
