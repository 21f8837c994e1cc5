"""Rendering a trained street: several blocks as one, fast."""
