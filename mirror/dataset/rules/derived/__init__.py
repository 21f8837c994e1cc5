"""IDX: the index, which is derived from everything else."""
