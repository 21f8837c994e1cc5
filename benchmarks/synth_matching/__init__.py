"""Feature matching and rig bundle adjustment on the synthetic street, compared with its exact truth."""
