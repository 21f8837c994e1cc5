"""Measures error and time of depth by PatchmatchNet and by plane sweeps, on synthetic and real images."""
