"""The roads of a scene: their lines and cross-sections, crossings, markings, lanes, and the ground around them."""
