"""Inference: one frame from its references, and rollouts frame by frame."""
