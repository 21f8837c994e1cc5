"""Detectors on the synthetic street: which faces and number plates they find, by size."""
