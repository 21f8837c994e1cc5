"""Reads the light, the mountings and the recorded gains of the cameras of training images."""

from __future__ import annotations

from collections.abc import Sequence

from hybridworldsim.light.recorded_light import RecordedCamera
from hybridworldsim.trainable.viewpoint import Source
from mirror.dataset.dataset import Dataset
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView


def read_recorded_cameras(dataset: Dataset, plan: Plan, views: Sequence[RenderView]) -> tuple[RecordedCamera, ...]:
    """Read the cameras of training views: one for each traversal and camera, sorted.

    Args:
        dataset: the dataset.
        plan: plan of the views.
        views: training views.

    Raises:
        DatasetError: an image is missing.
    """
    truth = GroundTruth(dataset, plan.protocol, plan.layers)
    first: dict[Source, RenderView] = {}
    for view in views:
        first.setdefault(Source(view.traversal_id, view.camera), view)
    cameras = []
    for source, view in sorted(first.items()):
        _, image = truth.recorded_frame_and_image(view)
        cameras.append(RecordedCamera(source, view.light, image.calibration.ego_SE3_camera.matrix()[0]))
    return tuple(cameras)
