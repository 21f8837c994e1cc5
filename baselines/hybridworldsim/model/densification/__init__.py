"""Where Gaussians are added and removed during training."""
