"""The method and the appearance policy that the manifest of a submission states."""

from __future__ import annotations

from typing import Final

from mirror.evaluation.submission.manifest import Appearance, SubmittedMethod
from mirror_baselines.mean_color.mean import MAX_IMAGES

METHOD: Final = SubmittedMethod(
    name="mean_color",
    version="1",
    licence="Apache-2.0",
    trained_on="nothing: the colours of the split's training traversals are averaged",
)
APPEARANCE: Final = Appearance(
    policy="mean", description=f"of at most {MAX_IMAGES} training pictures of the camera in the scene"
)
