"""PETR: boxes of road users from the images of several cameras (Y. Liu et al., PETR, ECCV 2022), in plain torch."""
