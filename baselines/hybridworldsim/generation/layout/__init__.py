"""The layout of a frame as images: boxes of road users, and lines of a map."""
