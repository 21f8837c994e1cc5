"""Streets to drive in: what a scenario needs to know of a synthetic street or of a scene of a dataset."""
