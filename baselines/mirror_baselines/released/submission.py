"""Brings the images of a generator to the raster of a protocol."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.dataset.images.decoding import decode_rgb
from mirror.errors import DatasetError
from mirror.evaluation.submission.writing import Render, Renderer
from mirror.protocols.truth.raster import cached_raster
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import Plan
from mirror.protocols.views.view import RenderView
from mirror_baselines.released.files import ReleasedFiles, ViewSource

_ASPECT: Final = 0.03
"""Largest relative difference of aspect ratios that counts as a squeezed image; 448 x 256 of 1600 x 900 has 0.016."""

_CODECS: Final = {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png"}


def make_renderer(files: ReleasedFiles) -> Renderer:
    """Make a renderer of submissions that reads the output of a generator.

    Args:
        files: the output.
    """

    def render(dataset: Dataset, plan: Plan) -> Iterator[Render]:
        sources = files.locate(plan)
        truth = GroundTruth(dataset, plan.protocol, plan.layers)
        for view, pixels in _read_all(plan.views, sources):
            _, image = truth.recorded_frame_and_image(view)
            camera = image.camera_model
            size = camera.width_px, camera.height_px
            recorded = to_recorded_size(pixels, *size, sources[view.path].file, lower_part=files.generator.lower_part)
            yield (view,), cached_raster(camera, plan.protocol.pixels).to_final(recorded)

    return render


def to_recorded_size(pixels: UInt8, width: int, height: int, file: Path, *, lower_part: bool = False) -> UInt8:
    """Scale a generated image to the size of the recorded one.

    Args:
        pixels: (h, w, 3).
        width: width of the recorded image.
        height: height of the recorded image.
        file: the generated file, for the error.
        lower_part: whether an image that is too low shows the lower part; the rows above it become black.

    Returns:
        (height, width, 3).

    Raises:
        DatasetError: the image has another aspect ratio.
    """
    scaled = pixels.shape[0] * width / pixels.shape[1]
    squeezed = abs(scaled - height) <= _ASPECT * height
    if not squeezed and not (lower_part and scaled < height):
        raise DatasetError(
            f"has {pixels.shape[1]} x {pixels.shape[0]} px, the recorded image {width} x {height} px",
            file=file,
            expected="an image of the same aspect ratio",
            remedy="have the generator write the whole image",
        )
    shape = (width, height if squeezed else round(scaled))
    method = cv2.INTER_AREA if shape[0] < pixels.shape[1] else cv2.INTER_LINEAR
    resized = pixels if shape == pixels.shape[1::-1] else cv2.resize(pixels, shape, interpolation=method)
    whole = np.zeros((height, width, 3), np.uint8)
    whole[height - resized.shape[0] :] = resized
    return whole


def _read_all(views: Sequence[RenderView], sources: Mapping[str, ViewSource]) -> Iterator[tuple[RenderView, UInt8]]:
    """Read the images of views: each video once, from its first frame to the last one that is needed."""
    images = [view for view in views if sources[view.path].frame is None]
    for view in images:
        file = sources[view.path].file
        pixels = decode_rgb(file.read_bytes(), _CODECS[file.suffix.lower()])
        if pixels is None:
            raise DatasetError("cannot be decoded", file=file, expected="a whole JPEG or PNG")
        yield view, pixels
    framed = [view for view in views if sources[view.path].frame is not None]
    framed.sort(key=lambda view: (str(sources[view.path].file), sources[view.path].frame))
    for file, members in groupby(framed, key=lambda view: sources[view.path].file):
        yield from _read_video(file, list(members), sources)


def _read_video(
    file: Path, views: Sequence[RenderView], sources: Mapping[str, ViewSource]
) -> Iterator[tuple[RenderView, UInt8]]:
    from mirror.recordings.video_file import open_video
    from mirror.recordings.video_frames import FrameConverter

    waiting = list(views)
    with open_video(file) as (container, stream):
        converter = FrameConverter()
        for number, frame in enumerate(container.decode(stream)):
            while waiting and sources[waiting[0].path].frame == number:
                yield waiting.pop(0), converter.to_rgb(frame)
            if not waiting:
                return
    raise DatasetError(
        f"ends before frame {sources[waiting[0].path].frame}", file=file, expected="the frames that its index lists"
    )
