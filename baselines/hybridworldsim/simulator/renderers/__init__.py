"""Renderers: the images of a rig at one instant of a rollout."""
