"""Closed loop: steps a second of a reconstructed street by part, errors of the vehicle, masks of composed agents."""
