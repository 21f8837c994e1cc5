"""Code that the learned depth estimators share: images as tensors, layers, warping, expectations, checkpoints."""
