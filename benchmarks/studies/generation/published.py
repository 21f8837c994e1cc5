"""FID and FVD of rollouts, where the published weights are there; the study's own distances need none of these."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from benchmarks.studies.generation.sheets import list_rolled_out
from benchmarks.studies.generation.study import Figures, Study
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.inference.clip_rollout import views_with_boxes
from mirror.arrays import UInt8
from mirror.metrics.features.fid import InceptionFeatures, fid, load_inception
from mirror.metrics.features.fvd import VideoFeatures, fvd, load_i3d
from mirror.weights.errors import WeightsUnavailableError

STAGE: Final = "published-distances"
FVD_FRAMES: Final = 16
"""Frames of a clip of FVD; rollouts are cut into as many as fit."""


def load_networks() -> tuple[InceptionFeatures | None, VideoFeatures | None]:
    """Return the networks of FID and FVD; None: its weights are not there.

    Raises:
        WeightsUnavailableError: neither is there.
    """
    inception, video, missing = None, None, []
    try:
        inception = load_inception()
    except WeightsUnavailableError as error:
        missing.append(error)
    try:
        video = load_i3d()
    except WeightsUnavailableError as error:
        missing.append(error)
    if inception is None and video is None:
        raise missing[0]
    return inception, video


def measure_published(study: Study, inception: InceptionFeatures | None, video: VideoFeatures | None) -> Figures:
    """Return the FID of images that show a box, and FVD of each view's rollout in parts, against the recorded images.

    Args:
        study: the study; every model that was rolled out over all test clips is measured.
        inception: network of FID; None: no FID.
        video: network of FVD; None: no FVD.

    Returns:
        ``fid`` and ``fvd`` by model; the empty background is among them.
    """
    figures: Figures = {}
    for name in _names(study):
        figures[name] = {}
        if inception is not None:
            figures[name]["fid"] = fid(_images(study, name), _images(study, None), inception).value
        if video is not None:
            figures[name]["fvd"] = fvd(_videos(study, name), _videos(study, None), video).value
    return figures


def _names(study: Study) -> list[str]:
    clips = [clip.clip_id for clip in study.test]
    complete = [
        name
        for name in list_rolled_out(study)
        if all((study.folder / "rollouts" / name / f"{clip}.npz").is_file() for clip in clips)
    ]
    return ["background", *complete]


def _read(study: Study, name: str | None, clip: Clip) -> UInt8:
    """Images (F - T, V, H, W, 3) of a model; None: the recorded ones."""
    if name is None:
        return clip.images[study.references :]
    if name == "background":
        return clip.background[study.references :]
    with np.load(study.folder / "rollouts" / name / f"{clip.clip_id}.npz") as file:
        images: UInt8 = file["images"]
    return images


def _images(study: Study, name: str | None) -> Iterator[UInt8]:
    for clip in study.test:
        images = _read(study, name, clip)
        for place, frame in enumerate(range(study.references, len(clip))):
            for view in np.flatnonzero(views_with_boxes(clip, frame) & clip.present[frame]):
                yield images[place, view]


def _videos(study: Study, name: str | None) -> Iterator[UInt8]:
    for clip in study.test:
        images = _read(study, name, clip)
        for first in range(0, len(images) - FVD_FRAMES + 1, FVD_FRAMES):
            for view in range(len(clip.views)):
                yield images[first : first + FVD_FRAMES, view]
