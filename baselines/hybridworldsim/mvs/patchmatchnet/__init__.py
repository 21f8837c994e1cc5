"""PatchmatchNet: Wang, Galliani, Vogel, Speciale, Pollefeys, "Learned Multi-View Patchmatch Stereo", CVPR 2021."""
