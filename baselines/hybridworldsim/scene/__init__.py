"""The static street: nodes of Gaussians whose looks depend on the traversal and the camera, in blocks of 100 m."""
