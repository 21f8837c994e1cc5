"""Static reconstruction: ours against vanilla 3DGS, MTGS-style and OmniRe-style, at equal cost, on declared scenes."""
