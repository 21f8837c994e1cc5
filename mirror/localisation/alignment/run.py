"""Aligns the passes of each scene of a dataset from their images, and writes layers ``poses/aligned@VERSION``.

All passes are mapped together by structure from motion: images of one pass with the next ones, and with images of the
other passes at the same place that look the same way. The map gets its scale and direction from the recorded ways of
all passes, each about its own middle, and its place from the median of their offsets: so a pass with a bias moves to
the others, and the map turns to where most of them say that it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.calibration.refinement.provenance import hash_inputs
from mirror.calibration.statistics import require_scipy
from mirror.dataset.dataset import Dataset
from mirror.dataset.derived_layer import find_missing
from mirror.dataset.layer_writer import require_layer_name
from mirror.dataset.writing import writing_layers
from mirror.errors import MirrorError, UsageError
from mirror.geometry import Poses, angle_between_deg, interpolate, matrix_from_quaternion
from mirror.geometry.geodesy import TangentFrame
from mirror.localisation.alignment.layer import SOURCE, aligned_layer, correct_track, write_aligned
from mirror.localisation.alignment.options import AlignmentOptions
from mirror.localisation.alignment.passes import (
    PassImages,
    SceneImages,
    choose_partners,
    join_passes,
    open_pass,
    read_pass,
)
from mirror.localisation.alignment.report import AlignmentReport, PassReport
from mirror.localisation.alignment.uncertainty import pass_sigmas
from mirror.localisation.structure.maps import ImageMap, MappedImages, map_images
from mirror.localisation.structure.run import require_pycolmap
from mirror.localisation.structure.similarity import Similarity, fit_track
from mirror.progress import NullProgress, ProgressReporter

METHOD: Final = "structure from motion over all passes, 1"
_SIGMA_M: Final = 1.0
"""1-sigma of the shape of a recorded way about its middle."""


_LEAST_WAY_M: Final = 8.0
_WINDOW: Final = 5
_JUMP_M: Final = 1.0
"""Recorded positions of neighbouring images share their error: larger jumps against them are wrong matches."""


def align_passes(
    dataset: Dataset,
    *,
    version: str = "1",
    options: AlignmentOptions | None = None,
    progress: ProgressReporter | None = None,
) -> AlignmentReport:
    """Bring the passes of each scene into one frame, and write their poses as layers ``aligned@VERSION``.

    A pass that cannot be matched gets a layer with its poses unchanged, and is named. An existing layer is kept.

    Args:
        dataset: a local dataset, or a view of whole traversals of it; its layers choose poses, calibrations, boxes.
        version: version of the layers.
        options: settings; None: the defaults.
        progress: receives the phases and their progress.

    Raises:
        UsageError: no scene has two traversals with images, or a package is missing.
        DatasetError: a layer of this version was made from other inputs, or another process writes the dataset.
    """
    require_pycolmap()
    require_scipy()
    require_layer_name(SOURCE, version)
    settings = options or AlignmentOptions()
    report = AlignmentReport(Path(dataset.root), f"{SOURCE}@{version}")
    rows = [row for row in dataset.table("traversals").to_pylist() if row["has_images"]]
    scenes = sorted({row["scene_id"] for row in rows})
    own = {scene: [row["traversal_id"] for row in rows if row["scene_id"] == scene] for scene in scenes}
    if not any(len(names) > 1 for names in own.values()):
        raise UsageError(
            "no scene has two traversals with images", file=dataset.root, expected="passes to align with each other",
            remedy="ingest further drives through the scene",
        )  # fmt: skip
    with writing_layers(dataset.layout):
        for scene in scenes:
            if len(own[scene]) > 1:
                view = dataset.where(traversal=own[scene])
                _SceneAlignment(view, scene, version, settings, report, progress or NullProgress()).run()
    return report


@dataclass
class _SceneAlignment:
    """The alignment of one scene."""

    view: Dataset
    scene: str
    version: str
    options: AlignmentOptions
    report: AlignmentReport
    progress: ProgressReporter

    def run(self) -> None:
        """Align the passes, unless all of them have the layer."""
        inputs = hash_inputs(self.view, {"method": METHOD, **asdict(self.options)})
        layers = {name: aligned_layer(self.view, name, self.version, inputs) for name in self.view.traversals()}
        missing, existing = find_missing(layers.values())
        self.report.passes += [PassReport(name, "existing") for name in existing]
        if not missing:
            return
        opened = [open_pass(self.view.where(traversal=name), self.options) for name in self.view.traversals()]
        self.progress.start(f"{self.scene}: features", sum(len(chosen) for _, chosen in opened))
        for one, chosen in opened:
            if one.problem is None:
                read_pass(one, chosen, self.options.features, self.progress.advance)
        passes = [one for one, _ in opened]
        placed = self._place([one for one in passes if one.problem is None])
        frame = self._frame()
        for one in passes:
            if one.traversal_id in missing:
                said, stamps, poses = placed.get(one.traversal_id) or (
                    PassReport(one.traversal_id, one.status, one.problem, len(one.images)), one.stamps, one.track,
                )  # fmt: skip
                self.report.passes.append(said)
                if said.status != "failed":
                    write_aligned(layers[one.traversal_id], stamps, poses, frame, said)

    def _frame(self) -> TangentFrame | None:
        (row,) = self.view.table("scenes").to_pylist()
        if row["longitude_deg"] is None:
            return None
        return TangentFrame(row["longitude_deg"], row["latitude_deg"], row["height_m"] or 0.0)

    def _place(self, passes: Sequence[PassImages]) -> dict[str, tuple[PassReport, Int64, Poses]]:
        """Map the passes together; the aligned ones by traversal. The others get the reason as their problem."""
        if len(passes) < 2:
            for one in passes:
                one.refuse("kept", "no other pass has images to match")
            return {}
        try:
            scene = join_passes(passes)
            found = self._map(scene)
        except MirrorError as error:
            for one in passes:
                one.refuse("kept", str(error))
            return {}
        seen = _registered(scene, found)
        shared = _shared_points(scene, found)
        joined: list[int] = []
        for number, one in enumerate(passes):
            others = sum(shared[number].values())
            if len(seen[number]) < max(3.0, self.options.least_share * len(one.images)):
                one.refuse("kept", f"{len(seen[number])} of {len(one.images)} images match those of the other passes")
            elif others < self.options.least_shared:
                one.refuse("kept", f"it shares {others} points with the other passes")
            else:
                joined.append(number)
        if len(joined) < 2:
            for number in joined:
                passes[number].refuse("kept", "no other pass could be matched with it")
            return {}
        self.report.residual_px[self.scene] = found.residual_px
        similarity = _fit_passes(scene, found, [seen[number] for number in joined])
        sigmas = pass_sigmas(scene, found, similarity.scale)
        placed = {}
        for number in joined:
            one, rows = passes[number], seen[number]
            places = similarity.move(found.world_SE3_camera.translation[rows])
            rows = rows[find_steady(places - scene.world_SE3_camera.translation[found.used[rows]])]
            images = found.used[rows]
            cameras = similarity.move_poses(found.world_SE3_camera[rows])
            stamps, poses = _ego_track(one, scene, images, cameras)
            before = interpolate(one.stamps, one.track, stamps)
            sigma = sigmas.get(number)
            said = PassReport(
                one.traversal_id, "aligned", None, len(one.images), len(rows),
                {passes[other].traversal_id: count for other, count in shared[number].items() if count},
                float(np.linalg.norm(poses.translation - before.translation, axis=1).mean()),
                float(angle_between_deg(poses.rotation, before.rotation).mean()),
                *(sigma or (None, None)),
            )  # fmt: skip
            placed[one.traversal_id] = (said, stamps, poses)
        return placed

    def _map(self, scene: SceneImages) -> ImageMap:
        lenses = [one.model for one in scene.calibrations]
        images = MappedImages(
            scene.features, scene.camera, lenses, [(lens.width_px, lens.height_px) for lens in lenses]
        )
        self.progress.start(f"{self.scene}: matches", len(images))
        maps, _ = map_images(images, choose_partners(scene, self.options), self.progress.advance)
        if not maps:
            raise UsageError("no two images could be matched", expected="passes whose images show the same surfaces")
        return maps[0]


def _registered(scene: SceneImages, found: ImageMap) -> list[Int64]:
    """Return the rows of the map that belong to each pass."""
    owner = scene.number[found.used]
    return [np.flatnonzero(owner == number) for number in range(len(scene.passes))]


def _shared_points(scene: SceneImages, found: ImageMap) -> list[dict[int, int]]:
    """Return for each pass the number of points that it shares with each other one."""
    shows = np.zeros((len(scene.passes), len(found.points)), np.bool_)
    for row, (points, _) in enumerate(found.observed):
        shows[scene.number[found.used[row]], points] = True
    every = range(len(scene.passes))
    return [
        {other: int(np.count_nonzero(shows[one] & shows[other])) for other in every if other != one} for one in every
    ]


def _fit_passes(scene: SceneImages, found: ImageMap, rows: Sequence[Int64]) -> Similarity:
    """Fit the map to the recorded ways of passes: each about its own middle, then the median of their offsets."""
    recorded = scene.world_SE3_camera[found.used]
    back = scene.ego_SE3_camera[found.used].inverse()
    vertical = matrix_from_quaternion((found.world_SE3_camera @ back).rotation)[:, :, 2]
    up = np.concatenate([vertical[own] for own in rows]).mean(axis=0)
    up /= np.linalg.norm(up)
    places, fixes = found.world_SE3_camera.translation, recorded.translation
    centred = [(places[own] - places[own].mean(axis=0), fixes[own] - fixes[own].mean(axis=0)) for own in rows]
    source, target = (np.concatenate(side) for side in zip(*centred))
    fit = fit_track(source, up, target, np.full(len(source), _SIGMA_M), _LEAST_WAY_M).similarity
    plain = Similarity(fit.scale, fit.turn, np.zeros(3))
    offsets: Float64 = np.array([(fixes[own] - plain.move(places[own])).mean(axis=0) for own in rows])
    return replace(plain, shift=np.median(offsets, axis=0))


def find_steady(moved_m: Float64) -> Bool:
    """Mark the images of a pass that moved about as their neighbours did; an image in a wrong place does not.

    Args:
        moved_m: (N, 3) how far each image moved from its recorded place, in order of time.
    """
    steady = np.ones(len(moved_m), np.bool_)
    for number in range(len(moved_m)):
        near = moved_m[max(0, number - _WINDOW) : number + _WINDOW + 1]
        steady[number] = bool(np.linalg.norm(moved_m[number] - np.median(near, axis=0)) <= _JUMP_M)
    return steady


def _ego_track(one: PassImages, scene: SceneImages, images: Int64, cameras: Poses) -> tuple[Int64, Poses]:
    """Return the corrected track of a pass from the poses of its images."""
    ego = cameras @ scene.ego_SE3_camera[images].inverse()
    times = np.array([scene.images[number].timestamp_ns for number in images.tolist()], np.int64)
    times, first = np.unique(times, return_index=True)
    return correct_track(one.stamps, one.track, times, ego[first])
