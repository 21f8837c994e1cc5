"""Tracking of noisy boxes against exact truth, beside greedy nearest-neighbour matching."""
