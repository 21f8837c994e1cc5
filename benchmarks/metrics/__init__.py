"""Measures time and error of metrics, for MIRROR and its peers, on one thread."""
