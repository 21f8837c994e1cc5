"""What every method of static reconstruction shares: images, budget, loop, checkpoints, run folder."""
