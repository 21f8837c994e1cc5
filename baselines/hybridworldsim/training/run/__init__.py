"""One run of a training, whatever is trained: loop, folder, budget, checkpoints, curves, interruption, processes."""
