"""Recall of face and number-plate detectors on the synthetic street, by size."""
