"""MVSNet: Yao, Luo, Li, Fang, Quan, "MVSNet: Depth Inference for Unstructured Multi-view Stereo", ECCV 2018."""
