"""Poses from images: of recordings that have none, and of the traversals of one street in one frame."""
