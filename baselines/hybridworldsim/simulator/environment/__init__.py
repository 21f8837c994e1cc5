"""The environment for Gymnasium: `gymnasium.make("mirror/Street-v0")`."""
