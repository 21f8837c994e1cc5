"""Generated frames as a submission to the protocols of generation: every view of a plan, edits included."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path

import cv2
import numpy as np
import torch

from hybridworldsim.generation.devices import require_counts
from hybridworldsim.generation.inference.blending import blend, draw_hulls, hull_shares
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions
from hybridworldsim.generation.scenes.backgrounds import Background, calibrations_of, open_background
from hybridworldsim.generation.scenes.generator_files import GeneratorFiles
from hybridworldsim.generation.scenes.rates import plan_rates, rate_note, rate_of
from hybridworldsim.generation.scenes.rig import rig_of
from hybridworldsim.generation.scenes.rollout import Generator, roll_out_sequence
from hybridworldsim.generation.scenes.scene_clip import PlannedFrame, SceneConditions, boxes_of, require_valid_boxes
from hybridworldsim.generation.scenes.scene_map import SceneMap, open_scene_map
from hybridworldsim.generation.text import Captions
from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.evaluation.submission.manifest import Appearance, Method
from mirror.evaluation.submission.writing import Render, write_submission
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.document import load_protocol
from mirror.protocols.views import plan_views
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.recalibration import recalibrate_views
from mirror.protocols.views.view import RenderView


@dataclass(frozen=True)
class SubmissionRequest:
    """What is submitted.

    Attributes:
        files: what the generator is read from.
        protocol: name or file of the protocol that asks for the views.
        split: split that the views are of.
        background: see `open_background`.
        appearance: appearance of a static model.
        size_px: height and width of generated images.
        rollout: how frames are generated.
        threads: number of torch threads; results repeat exactly with the same number.
        device: where the generator runs.
    """

    files: GeneratorFiles
    protocol: str
    split: str
    background: str
    appearance: str = "nearest"
    size_px: tuple[int, int] = (64, 96)
    rollout: ClipRolloutOptions = field(default_factory=ClipRolloutOptions)
    threads: int = 1
    device: str = "cpu"

    @property
    def method(self) -> Method:
        """What the submission states of the generator."""
        if self.files.base is None:
            return Method(
                name="hybridworldsim-generation", licence="Apache-2.0", trained_on="clips of other drives"
            )  # fmt: skip
        return Method(
            name=f"hybridworldsim-{self.files.base.name}", trained_on=self.files.base.trained_on, licence="MIT",
            url="https://github.com/SenseTime-FVG/OpenDWM",
        )  # fmt: skip

    def __post_init__(self) -> None:
        require_counts(threads=self.threads)


def generate_submission(
    dataset: Dataset, request: SubmissionRequest, out: Path, progress: ProgressReporter | None = None
) -> int:
    """Generate every view that a protocol asks for, and write the submission.

    Args:
        dataset: the dataset.
        request: what is submitted.
        out: a new or an empty folder, or that of an interrupted call with the same request.
        progress: receives the number of views and each written view.

    Returns:
        The number of views.

    Raises:
        UsageError: the request does not fit the dataset, or the folder holds other files.
        DatasetError: a model, image, background or map is missing, broken or does not fit.
        WeightsUnavailableError: released weights or captions are missing or do not fit.
    """
    torch.set_num_threads(request.threads)
    captions = request.files.read_captions()
    generator = request.files.open(request.size_px, request.device, request.rollout.sampler.guidance)
    plan = plan_views(dataset, load_protocol(request.protocol), request.split)
    for view in plan.views:
        if captions is not None:
            captions.require((view.traversal_id,), [view.camera])
    calibrations = calibrations_of(request.background)
    views = recalibrate_views(dataset, plan.views, calibrations)
    background, identity = open_background(request.background, dataset, request.appearance, views)
    for traversal in dict.fromkeys(view.traversal_id for view in plan.views):
        wanted = {view.frame_index for view in plan.views if view.traversal_id == traversal}
        frames = dataset.where(traversal=traversal).frames()
        require_valid_boxes(dataset, (frame for frame in frames if frame.frame_index in wanted))
    note = rate_note(plan_rates(dataset, plan), request.files.trained_rates())
    if note and progress is not None:
        progress.message(note)
    scenes = dict.fromkeys(view.scene_id for view in plan.views)
    maps = {scene: open_scene_map(dataset, scene, generator, progress or NullProgress()) for scene in scenes}
    inputs = (
        *(*request.files.hashes().values(), identity),
        *(repr(request.rollout), repr(request.size_px), str(dataset.layers.boxes)),
        *(str(request.threads), request.device),
        *(f"{name} of {scene}: {value}" for scene, one in maps.items() for name, value in one.inputs.items()),
    )
    return write_submission(
        dataset,
        plan,
        lambda _, requested: render_plan(
            dataset,
            plan,
            generator,
            background,
            request.size_px,
            request.rollout,
            requested.views,
            calibrations,
            captions,
            maps,
        ),
        request.method,
        Appearance(policy="other", description=f"of the background: {request.appearance}"),
        out,
        progress,
        of="|".join(inputs),
        notes=note,
    )


def render_plan(
    dataset: Dataset,
    plan: Plan,
    generator: Generator,
    background: Background,
    size_px: tuple[int, int],
    options: ClipRolloutOptions,
    missing: Sequence[RenderView],
    calibrations: str = "recorded",
    captions: Captions | None = None,
    maps: Mapping[str, SceneMap] | None = None,
) -> Iterator[Render]:
    """Generate every view of a plan, traversal by traversal.

    The requested frames of a traversal are one rollout. Backgrounds seed it: a recorded image of a held-out traversal
    is never read. A view without a road user is its background in the view's own raster; with `blend_px` so is what
    lies away from the hulls of road users.

    Args:
        dataset: the dataset; boxes and poses are read.
        plan: the requested views. Vehicles that it moves or removes are moved or removed from the first frame on.
        generator: network and autoencoder.
        background: images of the street without road users.
        size_px: height and width of generated images, which are scaled to the raster of their view.
        options: how frames are generated.
        missing: views of the plan that are wanted; a rollout without any is left out, and others run whole, so that the
            images do not depend on what an earlier call wrote.
        calibrations: layer of calibrations that places the cameras, as for `mirror render`; rasters are the plan's. A
            traversal without it has the recorded ones.
        captions: captions of the views; None: no text.
        maps: maps by scene; None: no map is shown to the generator.

    Yields:
        One view with its image at a time.
    """
    ordered = sorted(plan.views, key=lambda view: (view.group, view.traversal_id, view.frame_index, view.camera))
    wanted = {view.path for view in missing}
    for (_, traversal), group in groupby(ordered, key=lambda view: (view.group, view.traversal_id)):
        views = list(group)
        if not wanted & {view.path for view in views}:
            continue
        recorded = dataset.where(traversal=traversal).frames()
        frames = {frame.frame_index: frame for frame in recorded}
        numbers = sorted({view.frame_index for view in views})
        by_view = {(view.frame_index, view.camera): view for view in views}
        cameras = tuple(sorted({view.camera for view in views}))
        rig = rig_of(recorded, cameras, size_px, plan.protocol.pixels)
        planned = []
        for number in numbers:
            requested = [view for view in views if view.frame_index == number]
            camera = rig.cameras.index(requested[0].camera)
            # The plan has poses of cameras: the vehicle's follows from any of them.
            ego = requested[0].pose @ rig.ego_SE3_camera[camera].inverse()
            planned.append(PlannedFrame(frames[number], ego, requested[0].edits))
        tracks = {name: place for place, name in enumerate(planned[0].frame.track_ids)}
        rate_hz = rate_of([frames[number].timestamp_ns for number in numbers]) if len(numbers) > 1 else 1.0
        first = views[0]
        if calibrations != dataset.layers.calibrations:
            other = dataset.with_layers(calibrations=calibrations)
            rig = rig.at_calibrations(other.where(traversal=traversal).frames())
        placed = {view.path: view for view in recalibrate_views(dataset, views, calibrations)}
        lines = None if maps is None else maps[first.scene_id].lines
        scene = SceneConditions(rig, background, rate_hz, first.light, first.weather, tracks, captions, lines)
        seeds = [planned[0]] * generator.references
        # Blended below, in the raster of the view.
        rollout = roll_out_sequence(
            generator, [*seeds, *planned], scene, replace(options, blend_px=None), recorded_seeds=False
        )
        for frame, _ in rollout:
            place = frame.frame - generator.references
            number = numbers[place]
            shares = None
            if options.blend_px is not None:
                boxes = boxes_of([planned[place]], tracks)
                hulls = draw_hulls(boxes, rig.intrinsics, rig.ego_SE3_camera.matrix(), size_px)
                shares = hull_shares(hulls, options.blend_px)
            for row, camera_name in enumerate(rig.cameras):
                view = by_view.get((number, camera_name))
                if view is None or view.path not in wanted:
                    continue
                image = _enlarged(frame.images[row], view)
                if not frame.generated[row]:
                    image = background(placed[view.path])
                elif shares is not None:
                    share = cv2.resize(shares[row], (view.width_px, view.height_px), interpolation=cv2.INTER_LINEAR)
                    image = blend(image, background(placed[view.path]), np.asarray(share, np.float32))
                yield [view], image


def _enlarged(image: UInt8, view: RenderView) -> UInt8:
    size = (view.width_px, view.height_px)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), np.uint8)
