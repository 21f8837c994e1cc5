"""Clips: what the generator is trained on, images of a rig with their background, boxes, cameras and poses."""
