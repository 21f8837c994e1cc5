"""The method and the appearance policy that the manifest of a submission states."""

from __future__ import annotations

from typing import Final

from mirror.evaluation.submission.manifest import Appearance, SubmittedMethod

METHOD: Final = SubmittedMethod(
    name="nearest_frame",
    version="1",
    licence="Apache-2.0",
    trained_on="nothing: pictures of the split's training traversals are copied",
)
APPEARANCE: Final = Appearance(
    policy="nearest-traversal", description="of the traversal that the nearest picture is from"
)
