"""Passes of one street on different days, brought into one frame from their images: `mirror align`."""
