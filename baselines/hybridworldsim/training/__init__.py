"""What every method of static reconstruction shares: pictures, budget, loop, checkpoints, run folder."""
