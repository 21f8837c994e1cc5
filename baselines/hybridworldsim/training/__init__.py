"""Training shared by all methods of static reconstruction: images, budget, loop, checkpoints and run folder."""
