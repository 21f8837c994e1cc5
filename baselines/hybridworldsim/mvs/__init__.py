"""Multi-view stereo: depth maps and points from posed pictures, the initialisation of a reconstruction."""
