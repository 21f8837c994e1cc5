"""DEP: depth maps; PTS: points."""
