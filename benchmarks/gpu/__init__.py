"""The reference model on a GPU: rasterizer, frames, training, generation, features and the closed loop, in one call."""
