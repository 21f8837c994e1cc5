"""Refines the calibrations of a dataset scene by scene, and writes them as layers of stage ``refined``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

from mirror.arrays import Int64
from mirror.calibration.frame_choice import FrameChoice
from mirror.calibration.refinement.adjustment import adjust_rigs
from mirror.calibration.refinement.layer import SOURCE, refined_layer, write_refined
from mirror.calibration.refinement.matching import MatchingOptions, choose_pairs, join_tracks, match_pair
from mirror.calibration.refinement.provenance import hash_inputs
from mirror.calibration.refinement.report import METHOD, RefinementReport, TraversalRefinement
from mirror.calibration.refinement.rigs import FeatureTracks, RefinementPrior
from mirror.calibration.refinement.scene import SceneRigs, TraversalImages, gather_rigs, open_traversal, read_features
from mirror.calibration.refinement.shutters import estimate_times
from mirror.calibration.refinement.summary import CameraRefinement, summarise
from mirror.calibration.statistics import require_scipy
from mirror.dataset.dataset import Dataset
from mirror.dataset.derived_layer import find_missing
from mirror.dataset.layer_writer import require_layer_name
from mirror.dataset.unfinished_work import REFINEMENT, remove_work, work_folder
from mirror.dataset.writing import writing_layers
from mirror.errors import MirrorError, UsageError
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.finished_work import hash_values

DEFAULT_CHOICE: Final = FrameChoice(frames=12, step_m=2.0, step_deg=8.0)


@dataclass(frozen=True)
class _Settings:
    choice: FrameChoice
    prior: RefinementPrior
    matching: MatchingOptions


def refine_calibrations(
    dataset: Dataset,
    *,
    version: str = "1",
    choice: FrameChoice = DEFAULT_CHOICE,
    prior: RefinementPrior | None = None,
    matching: MatchingOptions | None = None,
    progress: ProgressReporter | None = None,
) -> RefinementReport:
    """Adjust the mountings and lenses of all cameras of each scene, and write them as layers ``refined@VERSION``.

    All traversals of a scene are adjusted together where their images match. A layer that exists is kept; no layer and
    no recorded calibration is changed. An interrupted run continues: features are kept in a work folder of the dataset.
    Memory: the features of the images of one scene, about 0.2 MB an image.

    Args:
        dataset: a local dataset, or a view of whole traversals of it; its layers choose poses, calibrations and boxes.
        version: version of the layers.
        choice: which frames of a traversal are used.
        prior: errors that the recorded values may have; None: the defaults.
        matching: settings of features and matches; None: the defaults.
        progress: receives the phases and their progress.

    Raises:
        UsageError: no traversal has images, the dataset is not local, or scipy is not installed.
        DatasetError: a layer of this version was made from other inputs, or another process writes the dataset.
    """
    require_scipy()
    require_layer_name(SOURCE, version)
    settings, reporter = _Settings(choice, prior or RefinementPrior(), matching or MatchingOptions()), progress
    report = RefinementReport(dataset.root, f"{SOURCE}@{version}")
    rows = [row for row in dataset.table("traversals").to_pylist() if row["has_images"]]
    if not rows:
        raise UsageError("no traversal has images", expected="images to refine the calibrations with")
    layout = dataset.layout
    with writing_layers(layout):
        for scene in sorted({row["scene_id"] for row in rows}):
            own = [row["traversal_id"] for row in rows if row["scene_id"] == scene]
            refinement = _SceneRefinement(dataset.where(traversal=own), scene, version, settings, report)
            refinement.run(reporter or NullProgress())
    return report


class _SceneRefinement:
    """The refinement of one scene."""

    def __init__(self, view: Dataset, scene: str, version: str, settings: _Settings, report: RefinementReport) -> None:
        self.view, self.scene, self.version, self.settings, self.report = view, scene, version, settings, report
        self.inputs = hash_inputs(view, {"method": METHOD, **asdict(settings)})
        self.layers = {name: refined_layer(view, name, version, self.inputs) for name in view.traversals()}
        self.missing, self.existing = find_missing(self.layers.values())

    @property
    def work(self) -> Path:
        """Folder of unfinished work; other inputs get another one."""
        return work_folder(self.view.layout, REFINEMENT, f"{SOURCE}@{self.version}", hash_values(self.inputs))

    def run(self, reporter: ProgressReporter) -> None:
        """Refine the traversals that have no layer yet, together with those that have one."""
        self.report.traversals += [TraversalRefinement(name, "existing") for name in self.existing]
        if not self.missing:
            return
        items = [
            open_traversal(self.view.where(traversal=name), self.settings.choice) for name in self.view.traversals()
        ]
        cameras: list[CameraRefinement] = []
        joined: SceneRigs | None = None
        if any(item.problem is None and item.traversal_id in self.missing for item in items):
            reporter.start(f"{self.scene}: features", sum(len(one.images) for item in items for one in item.frames))
            for item in items:
                read_features(item, self.settings.matching.features, self.view.store, self.work, reporter.advance)
            usable = [item for item in items if item.problem is None]
            try:
                joined, cameras = self._adjust(usable, reporter)
            except MirrorError as error:
                status = "not refined" if isinstance(error, UsageError) else "failed"
                for item in usable:
                    item.status, item.problem = status, str(error)
        for item in items:
            if item.traversal_id in self.missing:
                self._finish(item, joined, cameras)
        if not any(item.unread or item.status == "failed" for item in items):
            remove_work(self.work)

    def _adjust(
        self, items: Sequence[TraversalImages], reporter: ProgressReporter
    ) -> tuple[SceneRigs, list[CameraRefinement]]:
        if not items:
            raise UsageError("no image could be read", expected="images")
        joined = gather_rigs(items)
        tracks = self._match(joined, reporter)
        reporter.start(f"{self.scene}: adjustment", 0)

        def advance(steps: int) -> None:
            reporter.expect(steps)
            reporter.advance(steps)

        adjusted = adjust_rigs(joined.rigs, tracks, self.settings.prior, advance)
        self.report.steps[self.scene] = adjusted.steps
        references = {item.drive_id: item.reference or "" for item in items}
        refined = summarise(adjusted, joined, [references[drive] for drive in joined.drives])
        names = [one.camera for one in joined.calibrations]
        shutters = estimate_times(joined.rigs, tracks, names, self.settings.prior, advance)
        return joined, [replace(one, shutter=shutter) for one, shutter in zip(refined, shutters, strict=True)]

    def _match(self, joined: SceneRigs, reporter: ProgressReporter) -> FeatureTracks:
        options, matches = self.settings.matching, dict[tuple[int, int], Int64]()
        pairs = choose_pairs(joined.rigs, options)
        reporter.start(f"{self.scene}: matches", len(pairs))
        for one, other in pairs.tolist():
            found = match_pair(joined.rigs, one, other, joined.features, options)
            if len(found):
                matches[one, other] = found
            reporter.advance(1)
        self.report.matches[self.scene] = sum(len(found) for found in matches.values())
        return join_tracks(joined.features, matches)

    def _finish(self, item: TraversalImages, joined: SceneRigs | None, cameras: Sequence[CameraRefinement]) -> None:
        """Write the layer of a traversal, and report it."""
        own: list[CameraRefinement] = []
        if item.problem is None and joined is not None:
            paired = [(used, one) for used, one in zip(joined.calibrations, cameras) if one.drive_id == item.drive_id]
            own = [one for _, one in paired]
            if any(one.status == "refined" for one in own):
                write_refined(self.view, self.layers[item.traversal_id], paired)
            else:
                item.status, item.problem = "not refined", "no camera could be refined"
        images, unread = len(item.images), tuple(item.unread)
        self.report.traversals.append(
            TraversalRefinement(item.traversal_id, item.status, item.problem, len(item.frames), images, unread, own)
        )
