"""The parts of plane-sweep stereo: planes, correlations, smoothing."""
