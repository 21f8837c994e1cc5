"""Dynamic scene generation: a video diffusion transformer that adds traffic to the images of a static street."""
