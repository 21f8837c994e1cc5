"""A tiny PETR for any rig, trained in minutes of one processor core."""
