"""Structure from motion of one recording: frames by motion, a map by pycolmap, scale and world frame, a recording."""
