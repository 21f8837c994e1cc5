"""POS: the ego poses of a traversal, recorded and in layers."""
