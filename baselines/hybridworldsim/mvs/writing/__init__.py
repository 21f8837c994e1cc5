"""From depth maps to layers of a dataset, scene by scene."""
