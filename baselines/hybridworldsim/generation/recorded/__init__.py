"""Clips of a dataset's recordings: what `mirror generate clips` makes, and a generator is trained on."""
