"""Explicit Gaussians trained on pictures: what vanilla 3DGS, MTGS-style and OmniRe-style reconstruction share."""
