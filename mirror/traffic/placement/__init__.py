"""Where road users are: poses by length along a way and by time, and overlaps."""
