"""Generate the views that a protocol plans: one rollout for each traversal and group of edits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import cv2
import numpy as np

from hybridworldsim.generation.clips.captions import Captions
from hybridworldsim.generation.inference.blending import blend, draw_hulls, hull_shares
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions
from hybridworldsim.generation.scenes.backgrounds import Background
from hybridworldsim.generation.scenes.rates import rate_of
from hybridworldsim.generation.scenes.rig import SceneRig, rig_of
from hybridworldsim.generation.scenes.rollout import SceneGenerator, roll_out_sequence
from hybridworldsim.generation.scenes.scene_clip import PlannedFrame, SceneConditions, boxes_of
from hybridworldsim.generation.scenes.scene_map import SceneMap
from mirror.arrays import Float32, UInt8
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import FrameSequence
from mirror.evaluation.submission.writing import Render
from mirror.protocols.document import Pixels
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.recalibration import recalibrate_views
from mirror.protocols.views.view import RenderView


@dataclass(frozen=True)
class PlannedScenes:
    """The scenes that the views of a plan are generated from.

    Attributes:
        dataset: the dataset; boxes and poses are read.
        generator: network and autoencoder.
        background: images of the street without road users.
        size_px: height and width of generated images, which are scaled to the raster of their view.
        rollout: how frames are generated.
        calibrations: layer of calibrations that places the cameras, as for `mirror render`; rasters are the plan's. A
            traversal without it has the recorded ones.
        captions: captions of the views; None: no text.
        maps: maps by scene; None: no map is shown to the generator.
    """

    dataset: Dataset
    generator: SceneGenerator
    background: Background
    size_px: tuple[int, int]
    rollout: ClipRolloutOptions
    calibrations: str = "recorded"
    captions: Captions | None = None
    maps: Mapping[str, SceneMap] | None = None


def render_plan(scenes: PlannedScenes, plan: Plan, missing: Sequence[RenderView]) -> Iterator[Render]:
    """Generate every view of a plan, traversal by traversal.

    The requested frames of a traversal are one rollout. Backgrounds seed it: a recorded image of a held-out traversal
    is never read. A view without a road user is its background in the view's own raster; with `blend_px` so is what
    lies away from the hulls of road users.

    Args:
        scenes: what the views are generated from.
        plan: the requested views. Vehicles that it moves or removes are moved or removed from the first frame on.
        missing: views of the plan that are wanted; a rollout without any is left out, and others run whole, so that the
            images do not depend on what an earlier call wrote.

    Yields:
        One view with its image at a time.
    """
    ordered = sorted(plan.views, key=lambda view: (view.group, view.traversal_id, view.frame_index, view.camera))
    wanted = {view.path for view in missing}
    for _, group in groupby(ordered, key=lambda view: (view.group, view.traversal_id)):
        views = list(group)
        if wanted & {view.path for view in views}:
            yield from _render_rollout(scenes, plan.protocol.pixels, views, wanted)


def _render_rollout(
    scenes: PlannedScenes, pixels: Pixels, views: Sequence[RenderView], wanted: set[str]
) -> Iterator[Render]:
    """Generate the views of one traversal and one group of edits; the paths of those that are yielded are given."""
    dataset, first, blend_px = scenes.dataset, views[0], scenes.rollout.blend_px
    recorded = dataset.where(traversal=first.traversal_id).frames()
    rig = rig_of(recorded, tuple(sorted({view.camera for view in views})), scenes.size_px, pixels)
    planned = _plan_frames(recorded, rig, views)
    numbers = [one.frame.frame_index for one in planned]
    tracks = {name: place for place, name in enumerate(planned[0].frame.track_ids)}
    rate_hz = rate_of([one.frame.timestamp_ns for one in planned]) if len(planned) > 1 else 1.0
    if scenes.calibrations != dataset.layers.calibrations:
        other = dataset.with_layers(calibrations=scenes.calibrations)
        rig = rig.at_calibrations(other.where(traversal=first.traversal_id).frames())
    placed = {view.path: view for view in recalibrate_views(dataset, views, scenes.calibrations)}
    by_view = {(view.frame_index, view.camera): view for view in views if view.path in wanted}
    lines = None if scenes.maps is None else scenes.maps[first.scene_id].lines
    conditions = SceneConditions(
        rig, scenes.background, rate_hz, first.light, first.weather, tracks, scenes.captions, lines
    )
    references = scenes.generator.references
    # Blended below, in the raster of the view.
    rollout = roll_out_sequence(
        scenes.generator,
        [*[planned[0]] * references, *planned],
        conditions,
        replace(scenes.rollout, blend_px=None),
        recorded_seeds=False,
    )
    for frame, _ in rollout:
        place = frame.frame - references
        shares = None
        if blend_px is not None:
            boxes = boxes_of([planned[place]], tracks)
            hulls = draw_hulls(boxes, rig.intrinsics, rig.ego_SE3_camera.matrix(), scenes.size_px)
            shares = hull_shares(hulls, blend_px)
        for row, camera in enumerate(rig.cameras):
            view = by_view.get((numbers[place], camera))
            if view is None:
                continue
            if not frame.generated[row]:
                image = scenes.background(placed[view.path])
            else:
                image = _resize(frame.images[row], view)
                if shares is not None:
                    image = _blend(image, scenes.background(placed[view.path]), shares[row])
            yield [view], image


def _plan_frames(recorded: FrameSequence, rig: SceneRig, views: Sequence[RenderView]) -> list[PlannedFrame]:
    """The frames of a rollout in time order; the plan has poses of cameras: the vehicle's follows from any of them."""
    frames = {frame.frame_index: frame for frame in recorded}
    planned = []
    for number, view in sorted({view.frame_index: view for view in reversed(views)}.items()):
        ego = view.pose @ rig.ego_SE3_camera[rig.cameras.index(view.camera)].inverse()
        planned.append(PlannedFrame(frames[number], ego, view.edits))
    return planned


def _resize(image: UInt8, view: RenderView) -> UInt8:
    size = (view.width_px, view.height_px)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), np.uint8)


def _blend(image: UInt8, background: UInt8, shares: Float32) -> UInt8:
    size = (image.shape[1], image.shape[0])
    return blend(image, background, np.asarray(cv2.resize(shares, size, interpolation=cv2.INTER_LINEAR), np.float32))
