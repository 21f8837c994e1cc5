"""The model of a static street: nodes of Gaussians in blocks of 100 m, decoded for an appearance, and rendered."""
