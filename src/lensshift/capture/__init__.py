"""From devices to a burst: plans, the protocols of stage and camera, acquisition."""
