"""Flow matching: noise levels, the losses of training, and the sampler."""
