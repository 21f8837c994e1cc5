"""Decoding of images and videos, and the codec of depth maps."""
