"""Initialisation without networks against the synthetic street's exact truth: depth, ground, sky, and time."""
