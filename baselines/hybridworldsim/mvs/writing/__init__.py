"""Writes depth maps, points and masks as layers of a dataset, scene by scene."""
