"""The import path of `hybridworldsim.trainable.method` in methods that were written for version 0.1."""

from hybridworldsim.trainable.method import CoverRenderableModel as CoverTrainableMethod
from hybridworldsim.trainable.method import Rendering, StepReport, TrainableMethod

__all__ = ["CoverTrainableMethod", "Rendering", "StepReport", "TrainableMethod"]
