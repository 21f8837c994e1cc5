"""Refinement of calibrations: mountings and lenses of all cameras of a scene, adjusted jointly to matched features."""
