"""IMG012."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("IMG012", Severity.ERROR, remedy="`mirror ingest RECORDING... --replace`")
def video_stamp(view: SceneView) -> Iterator[Finding]:
    """A picture in a video has no `video_pts`, or one that lies in a file of its own has one."""
    images = view.all_images
    codes, words = images.words("codec")
    video = np.isin(codes, [code for code, word in enumerate(words) if word == "video"])
    stamped = images.known("video_pts")
    yield from images.findings(
        video != stamped,
        lambda row: f"codec {images.word('codec', row)} {'without' if video[row] else 'with'} video_pts",
    )
