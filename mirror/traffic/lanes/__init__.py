"""Lanes and their network, paths through it, and the smooth ways along lanes."""
