"""Calibration checking and refinement on the synthetic street, compared with the injected errors."""
