"""Rollouts with a policy: the run, its folder and its video."""
