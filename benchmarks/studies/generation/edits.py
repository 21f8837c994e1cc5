"""Moved vehicles: which are moved, what is generated of them, and whether they are where they were asked to be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from torch import nn

from benchmarks.studies.generation.judge_data import judged_boxes
from benchmarks.studies.generation.judges import segment
from benchmarks.studies.generation.rollouts import shorten
from hybridworldsim.generation.clips.clip import CATEGORIES, Clip
from hybridworldsim.generation.clips.edits import move_track
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions, roll_out_clip
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
from hybridworldsim.generation.layout.boxes import OWN_STYLE, draw_inverse_depth
from hybridworldsim.generation.model_files import read_autoencoder, read_generator
from mirror.arrays import Bool, UInt8
from mirror.progress import ProgressReporter

VEHICLES: Final = ("car", "van", "truck", "bus")


@dataclass(frozen=True, eq=False)
class Edit:
    """A vehicle that is moved to its left in a stretch of a clip.

    Attributes:
        clip: the stretch; its first T frames are seeds, in which the background replaces the vehicle and it has no box.
        track: number of the vehicle.
        dy_m: metres to its left.
    """

    clip: Clip
    track: int
    dy_m: float


@dataclass(frozen=True)
class EditScore:
    """Overlap of the vehicle's region with its target, in one view of one frame.

    Attributes:
        found: of the generated image.
        floor: of the recorded image, in which the vehicle stands unmoved: what an ignored edit gets.
        ceiling: of the recorded image with the unmoved box: what the segmenter gets on a true image.
    """

    found: float
    floor: float
    ceiling: float


def plan_edits(
    clips: Sequence[Clip], references: int, frames: int, per_clip: int, dy_m: float, least_px: int, nearest_m: float
) -> list[Edit]:
    """Choose vehicles that are judged longest, each from the first frame in which it is judged.

    Args:
        clips: the test clips.
        references: T, number of seeds.
        frames: number of generated frames.
        per_clip: largest number of vehicles of a clip.
        dy_m: metres to the left.
        least_px: least number of pixels of a target.
        nearest_m: edits whose box comes nearer to a camera are left out.
    """
    edits = []
    for clip in clips:
        seen: dict[int, list[int]] = {}
        for box in judged_boxes(clip):
            if CATEGORIES[box.category] in VEHICLES and box.frame >= references:
                seen.setdefault(box.track, []).append(box.frame)
        longest = sorted(seen, key=lambda track: (-len(seen[track]), track))[:per_clip]
        for track in longest:
            first = min(min(seen[track]), len(clip) - frames)
            if first < references:
                continue
            stretch = shorten(clip, first - references, first + frames)
            edit = Edit(_without(stretch, track, references), track, dy_m)
            if _nearest_m(edit) >= nearest_m and _target_px(edit, references) >= least_px:
                edits.append(edit)
    return edits


def generate_edits(
    generator: Path, autoencoder: Path, edits: Sequence[Edit], steps: int, progress: ProgressReporter
) -> list[UInt8]:
    """Generate the stretches of edits: images (F, V, H, W, 3) of each."""
    network, references = read_generator(generator)
    codec = read_autoencoder(autoencoder)
    options = ClipRolloutOptions(SamplerSettings(steps), keep_empty_views=False)
    found = []
    progress.start("edits", len(edits))
    for edit in edits:
        moved = move_track(edit.clip, edit.track, dy=edit.dy_m)
        frames = roll_out_clip(network, codec, edit.clip, OWN_STYLE, references, references, options, edited=moved)
        found.append(np.stack([frame.images for frame in frames]))
        progress.advance(1)
    return found


def score_edit(edit: Edit, images: UInt8, segmenter: nn.Module, least_px: int) -> list[EditScore]:
    """Score the views in which the target has enough pixels.

    Args:
        edit: the edit.
        images: (F, V, H, W, 3) its generated frames.
        segmenter: the segmenter of the study.
        least_px: least number of pixels of a target.
    """
    clip, references = edit.clip, len(edit.clip) - len(images)
    moved = move_track(clip, edit.track, dy=edit.dy_m)
    scores = []
    for frame in range(references, len(clip)):
        background = clip.background[frame]
        regions = segment(segmenter, images[frame - references], background)
        recorded = segment(segmenter, clip.images[frame], background)
        target, others = _hulls(moved, frame, edit.track)
        unmoved, _ = _hulls(clip, frame, edit.track)
        for view in range(len(clip.views)):
            judged = ~others[view]
            if (target[view] & judged).sum() < least_px or (unmoved[view] & judged).sum() < least_px:
                continue
            scores.append(
                EditScore(
                    _iou(regions[view], target[view], judged),
                    _iou(recorded[view], target[view], judged),
                    _iou(recorded[view], unmoved[view], judged),
                )
            )
    return scores


def normalise(scores: Sequence[EditScore]) -> dict[str, float]:
    """Return the means, and the mean overlap between floor (0) and ceiling (1)."""
    found, floor, ceiling = (float(np.mean([getattr(one, name) for one in scores])) for name in _NAMES)
    return {
        "iou": found,
        "floor": floor,
        "ceiling": ceiling,
        "normalised": (found - floor) / (ceiling - floor),
        "n": len(scores),
    }


_NAMES: Final = ("found", "floor", "ceiling")


def _without(clip: Clip, track: int, references: int) -> Clip:
    """The clip without a vehicle in the seeds: neither its pixels nor its boxes.

    A box around empty street would tell the network that this road user looks like the street.
    """
    if clip.tracks is None:
        return clip
    images = clip.images.copy()
    mask = clip.tracks[:references] == track
    images[:references][mask] = clip.background[:references][mask]
    kept = (clip.boxes.track != track) | (clip.boxes.frame >= references)
    return replace(clip, images=images, boxes=clip.boxes[kept])


def _hulls(clip: Clip, frame: int, track: int) -> tuple[Bool, Bool]:
    """Pixels (V, H, W) of the box of a track, and of all other boxes."""
    boxes = clip.boxes.at(frame)
    own, others = [], []
    for mount, lens in zip(clip.ego_SE3_camera, clip.intrinsics):
        drawn = [
            draw_inverse_depth(np.linalg.inv(mount) @ part.ego_SE3_box, part.lwh_m, lens, clip.size_px, 1.0) > 0.0
            for part in (boxes[boxes.track == track], boxes[boxes.track != track])
        ]
        own.append(drawn[0])
        others.append(drawn[1])
    return np.stack(own), np.stack(others)


def _iou(region: Bool, target: Bool, judged: Bool) -> float:
    both, either = (region & target & judged).sum(), ((region | target) & judged).sum()
    return float(both / either) if either else 0.0


def _nearest_m(edit: Edit) -> float:
    """Least distance of the moved box's centre from a camera."""
    moved = move_track(edit.clip, edit.track, dy=edit.dy_m).boxes
    centres = moved.ego_SE3_box[moved.track == edit.track][:, :3, 3]
    cameras = edit.clip.ego_SE3_camera[:, :3, 3]
    return float(np.linalg.norm(centres[:, None] - cameras, axis=2).min())


def _target_px(edit: Edit, references: int) -> int:
    """Largest number of pixels of the target in a view."""
    moved = move_track(edit.clip, edit.track, dy=edit.dy_m)
    return max(
        int(_hulls(moved, frame, edit.track)[0].sum(axis=(1, 2)).max()) for frame in range(references, len(moved))
    )
