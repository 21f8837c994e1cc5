"""The import path of `hybridworldsim.trainable.training_image` in methods that were written for version 0.1."""

from hybridworldsim.trainable.training_image import TrainingImage

__all__ = ["TrainingImage"]
