"""What learned estimators of depth share: layers, warping, expectations, checkpoints, and what a picture may cost."""
