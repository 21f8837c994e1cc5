"""Tracking: single-frame boxes become objects with ids, smooth paths, velocities and one size each."""
