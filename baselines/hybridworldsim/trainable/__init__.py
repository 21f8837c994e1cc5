"""The interface of trainable street models: the viewpoints and images that they get, the renderings that they give."""
