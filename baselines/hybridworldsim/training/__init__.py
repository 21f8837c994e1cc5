"""Training: ``run`` is the loop and the folder of all that is trained; beside it stands what trains streets."""
