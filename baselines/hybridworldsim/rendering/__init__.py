"""Rendering a trained street: several blocks at once, fast, along trajectories, as pictures or a video."""
