"""Depth by PatchmatchNet and by plane sweeps: error by distance and time, on the synthetic street and real images."""
