"""Explicit Gaussians trained on images: the parts that the 3DGS, MTGS-style and OmniRe-style methods share."""
