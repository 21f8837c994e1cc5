"""Feature matching and rig bundle adjustment on the synthetic street, against its exact truth."""
