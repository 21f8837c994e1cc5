"""The images of a split, and the choice of the images that are matched with each other."""
