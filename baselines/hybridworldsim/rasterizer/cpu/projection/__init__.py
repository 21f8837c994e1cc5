"""Projects Gaussians to the ellipses that reach an image."""
