"""Numbers of a scene from measured poses, or from goals: calibration and design."""
