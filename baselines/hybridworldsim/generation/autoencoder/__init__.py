"""Autoencoders: images to latents and back. Their reconstruction error bounds all that is generated from latents."""
