"""Regions added to those that detectors found: along tracks, in other cameras, and from the geometry of vehicles."""
