"""The documents of a run that trains one block of a street: ``run.json`` and ``outcome.json``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, Literal

from hybridworldsim.training.run.document import RUN, Computation
from mirror.schema.documents import Document
from mirror.schema.files import read_json

PREVIEWS: Final = "pictures"
"""Folder of the images that are rendered during training."""


class TrainedCamera(Document):
    """A camera in a traversal that was trained on.

    Attributes:
        traversal_id: the traversal.
        camera: name of the camera in the rig.
        light: light of the traversal.
        weather: weather of the traversal.
        centre_m: (N, 3) some of the camera's positions, in the scene's world frame.
        forward: (N, 3) viewing directions at these positions.
    """

    traversal_id: str
    camera: str
    light: str
    weather: str
    centre_m: tuple[tuple[float, float, float], ...]
    forward: tuple[tuple[float, float, float], ...]


class Run(Document):
    """``run.json``: everything that determines the result of a run.

    Attributes:
        format: always ``mirror-run``.
        version: version of this document.
        method: name of the method's entry point.
        settings: settings of the method.
        seed: seed of all random numbers.
        steps: the budget, or None.
        core_minutes: the budget, or None.
        threads: number of torch threads; results repeat exactly with the same number.
        scene: id of the scene.
        split: name of the split.
        block: name of the block within the scene.
        origin_m: origin of the block's frame, in the scene's world frame.
        radius_m: radius of the block.
        width_px: largest width of images.
        half: whether the model is written in half precision.
        dataset_hash: hash of the data that the split was made of.
        plan_hash: hash of the training images, their raster and the layers of masks.
        settings_hash: hash of the method's settings.
        depth: ``source@version`` of the layers of depth maps, or None.
        points: ``source@version`` of the layers of points, or None.
        poses: layer of poses.
        calibrations: layer of calibrations.
        stage: stage of calibration, or None for the best of each traversal.
        pictures: number of training images.
        withheld: ``traversal/camera/timestamp_ns`` of images of training traversals that are not read.
        sources: trained traversals and cameras.
        computed: what it computes with; None in runs of version 0.1.0, which computed on the CPU. Versions may change
            when a run is continued, the kind of device may not.
    """

    format: Literal["mirror-run"] = "mirror-run"
    version: Literal["1"] = "1"
    method: str
    settings: dict[str, Any]
    seed: int
    steps: int | None
    core_minutes: float | None
    threads: int
    scene: str
    split: str
    block: str
    origin_m: tuple[float, float, float]
    radius_m: float
    width_px: int
    half: bool
    dataset_hash: str
    plan_hash: str
    settings_hash: str
    depth: str | None
    points: str | None
    poses: str = "recorded"
    calibrations: str = "recorded"
    stage: str | None = None
    pictures: int
    withheld: tuple[str, ...] = ()
    sources: tuple[TrainedCamera, ...]
    computed: Computation | None = None


class TrainingOutcome(Document):
    """``outcome.json``: the result of a finished run.

    Attributes:
        steps: number of images trained on.
        skipped: number of images without a scored pixel.
        core_s: processor time of training.
        wall_s: wall time of training.
        psnr_db: PSNR of the last training images, over their scored pixels.
        gaussians: number of Gaussians.
        model_bytes: size of ``model.safetensors``.
    """

    steps: int
    skipped: int
    core_s: float
    wall_s: float
    psnr_db: float
    gaussians: int
    model_bytes: int


def read_run(path: Path) -> Run:
    """Read the document of a run.

    Raises:
        DatasetError: no run began in the folder.
        SchemaError: the document is broken.
    """
    return read_json(path / RUN, Run)
