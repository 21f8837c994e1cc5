"""Explicit Gaussians trained on images: what vanilla 3DGS, MTGS-style and OmniRe-style reconstruction share."""
