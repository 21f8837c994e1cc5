"""The nodes of a street: sky and ground of Code-Gaussians, background of anchors."""
