"""Compares static reconstruction by our method with 3DGS, MTGS-style and OmniRe-style, at equal cost."""
