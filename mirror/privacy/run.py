"""De-identifying a dataset: every recorded image is searched, redacted and written as a layer; the recording stays.

The images of a traversal are searched first, with results that survive an interruption. When all are done, regions are
propagated, and a layer of redacted images and one of masks is written. So a layer is complete or absent.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import pyarrow.compute as pc

from mirror.dataset import open as open_dataset
from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.dataset import Dataset
from mirror.dataset.derived_layer import find_missing
from mirror.dataset.images.shards import is_shard
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import require_layer_name
from mirror.dataset.layout import Layout, require_dataset
from mirror.dataset.taken_down import drop_images, group_by_traversal, read_take_downs
from mirror.dataset.unfinished_work import DEIDENTIFICATION, remove_work, work_folder
from mirror.dataset.writing import writing_layers
from mirror.errors import ExitCode, MirrorError
from mirror.executors.choice import ExecutorChoice
from mirror.executors.executor import SerialExecutor
from mirror.executors.job import Failure, ParallelJob
from mirror.executors.processes import ProcessesExecutor
from mirror.privacy.detection import (
    DetectionLog,
    DetectionPool,
    DetectionTask,
    ImageKey,
    detect_images,
    used_masks,
)
from mirror.privacy.detectors.registry import describe, require_coverage
from mirror.privacy.geometry import propagate, visible_objects
from mirror.privacy.options import DeidentifyOptions, configuration_hash, detection_hash
from mirror.privacy.regions import Region, covered_share, grown_box, merged
from mirror.privacy.writing import SOURCE, Configuration, redaction_layer, write_layers
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.documents import Rig
from mirror.schema.files import read_table
from mirror.schema.tables import IMAGES, MASKS

_COVERED: Final = 0.9


@dataclass(frozen=True)
class ImageFailure:
    """An image without a result.

    Attributes:
        traversal_id: the traversal.
        camera: the camera.
        timestamp_ns: mid-exposure.
        status: `failed`, `crashed` or `hung`.
        problem: what happened, in words.
    """

    traversal_id: str
    camera: str
    timestamp_ns: int
    status: str
    problem: str


@dataclass
class DeidentifyReport:
    """The result of a de-identification run.

    Attributes:
        version: version of the layers.
        written: ids of traversals with a new layer.
        unchanged: ids of traversals that had it.
        unfinished: ids of traversals that wait for images that failed.
        images: number of images in new layers.
        regions: number of regions in them, by kind and origin, such as ``plate/vehicle``.
        redacted: number of images with regions.
        skipped: number of tiles and images that were not searched, by the rule.
        failures: images without a result.
        broken: why workers ended without a result, by traversal.
    """

    version: str
    written: list[str] = field(default_factory=list)
    unchanged: list[str] = field(default_factory=list)
    unfinished: list[str] = field(default_factory=list)
    images: int = 0
    redacted: int = 0
    regions: Counter[str] = field(default_factory=Counter)
    skipped: Counter[str] = field(default_factory=Counter)
    failures: list[ImageFailure] = field(default_factory=list)
    broken: dict[str, str] = field(default_factory=dict)

    def add(self, one: DeidentifyReport) -> None:
        """Add the results of another traversal."""
        self.written += one.written
        self.unfinished += one.unfinished
        self.failures += one.failures
        self.images += one.images
        self.redacted += one.redacted
        self.regions += one.regions
        self.skipped += one.skipped

    def exit_code(self) -> ExitCode:
        """Return the exit code of `mirror deidentify`."""
        if not self.failures and not self.broken:
            return ExitCode.DONE
        return ExitCode.PARTLY_DONE


def deidentify(
    root: str | Path,
    options: DeidentifyOptions,
    *,
    traversals: Sequence[str] | None = None,
    progress: ProgressReporter | None = None,
    wait: bool = False,
) -> DeidentifyReport:
    """De-identify a dataset. The recorded images are read and never changed.

    Args:
        root: the dataset's folder.
        options: detectors, operators, propagation.
        traversals: ids of the traversals; None: all.
        progress: receives the progress.
        wait: wait for another run that writes the dataset.

    Raises:
        DatasetError: there is no dataset, it is locked, or a layer of this version was made with other options.
        UsageError: no plate detector covers the plates' region, or a traversal does not exist.
        WeightsUnavailableError: weights are missing or not the published ones; nothing was written.

    Example:
        >>> from mirror.privacy import DeidentifyOptions, deidentify, parse_choice  # doctest: +SKIP
        >>> chosen = [parse_choice("centerface"), parse_choice("world_plates")]
        >>> options = DeidentifyOptions(detectors=chosen, plate_region="CN")
        >>> deidentify("dataset", options).exit_code()  # doctest: +SKIP
    """
    layout = Layout(Path(root))
    require_dataset(layout)
    require_layer_name(SOURCE, options.version)
    options = replace(options, plate_region=require_coverage(options.detectors, options.plate_region))
    # Missing weights end the run here, before anything is written.
    records = [describe(choice.make()) for choice in options.detectors]
    configuration = Configuration(
        options.version, configuration_hash(records, options), tuple(records), options.redaction, options.plate_region
    )  # fmt: skip
    bar = NullProgress() if progress is None else progress
    report = DeidentifyReport(options.version)
    with writing_layers(layout, wait=wait):
        build_index(layout.root)
        dataset = open_dataset(str(layout.root))
        chosen = dataset.traversals() if traversals is None else dataset.where(traversal=traversals).traversals()
        counts = {name: dataset.where(traversal=name).count("images") for name in chosen}
        todo, report.unchanged = find_missing(
            redaction_layer(layout, name, configuration) for name in chosen if counts[name]
        )
        bar.start("images searched", sum(counts[name] for name in todo))
        folder = work_folder(layout, DEIDENTIFICATION, options.version, detection_hash(records, options))
        if options.executor is not None and options.executor.kind == "ray":
            settings = _TraversalSettings(
                Layout(layout.root.absolute()), replace(options, workers=1, executor=None), configuration,
                folder.absolute(),
            )  # fmt: skip
            _on_cluster(options.executor, settings, todo, report, bar)
        else:
            is_serial = options.executor is not None and options.executor.kind == "serial"
            executor = SerialExecutor() if is_serial else ProcessesExecutor(options.workers)
            with DetectionPool(layout.root, options.detectors, executor, options.timeout_s) as pool:
                for name in todo:
                    _traversal(layout, dataset, name, options, configuration, pool, folder, report, bar)
        if not report.unfinished:
            remove_work(folder)
    return report


@dataclass(frozen=True)
class _TraversalSettings:
    """The settings of a worker of a cluster, for all traversals."""

    layout: Layout
    options: DeidentifyOptions
    configuration: Configuration
    folder: Path


def _on_cluster(
    choice: ExecutorChoice,
    settings: _TraversalSettings,
    todo: Sequence[str],
    report: DeidentifyReport,
    bar: ProgressReporter,
) -> None:
    """De-identify traversals on the workers of a cluster, a traversal at a time."""
    with choice.open() as workers:
        for number, answer in workers.map(ParallelJob(_make_deidentification, (settings,)), todo):
            if not isinstance(answer, Failure):
                report.add(answer)
                bar.advance(answer.images)
            elif isinstance(answer.error, MirrorError):
                raise answer.error
            else:
                report.broken[todo[number]] = f"{answer.problem} ({answer.attempts} attempts)"
                report.unfinished.append(todo[number])
    for names in (report.written, report.unfinished):
        names.sort()
    report.failures.sort(key=lambda one: (one.traversal_id, one.camera, one.timestamp_ns))


def _make_deidentification(settings: _TraversalSettings) -> Callable[[str], DeidentifyReport]:
    layout, options = settings.layout, settings.options
    dataset = open_dataset(str(layout.root))
    # A detector may end its process: it fails on one image then, not on a traversal.
    pool = DetectionPool(layout.root, options.detectors, ProcessesExecutor(1), options.timeout_s)

    def deidentify_one(name: str) -> DeidentifyReport:
        report = DeidentifyReport(options.version)
        _traversal(
            layout, dataset, name, options, settings.configuration, pool, settings.folder, report, NullProgress()
        )
        return report

    return deidentify_one


def _traversal(
    layout: Layout,
    dataset: Dataset,
    traversal_id: str,
    options: DeidentifyOptions,
    configuration: Configuration,
    pool: DetectionPool,
    folder: Path,
    report: DeidentifyReport,
    bar: ProgressReporter,
) -> None:
    log = DetectionLog(folder / f"{traversal_id}.jsonl")
    hashes = ContentHashes(dataset.store)
    tasks = _tasks(layout, dataset, traversal_id, options)
    searched, failures = detect_images(tasks, pool, log, hashes, bar.advance)
    report.failures += _named(traversal_id, failures)
    if failures and not options.withhold_failed:
        report.unfinished.append(traversal_id)
        return
    done = [task for task in tasks if task.key in searched]
    detected = {task.key: searched[task.key].regions for task in done}
    regions = propagate(dataset, traversal_id, detected, options.propagation, grow=options.redaction.grow)
    failures = _repeat(traversal_id, done, regions, options, configuration, pool, folder, hashes)
    report.failures += _named(traversal_id, failures)
    if failures and not options.withhold_failed:
        report.unfinished.append(traversal_id)
        return
    regions = {key: found for key, found in regions.items() if key not in failures}
    skipped = {key: searched[key].skipped for key in regions}
    # The redaction reads bytes with the hash of the search, or fails.
    rows = {
        task.key: {**task.row, "sha256": bytes.fromhex(searched[task.key].sha256)}
        for task in done
        if task.key in regions
    }
    bar.status(f"writing {traversal_id}")
    in_shards = options.shards
    if in_shards is None:
        in_shards = any(is_shard(task.row["uri"]) for task in tasks)
    write_layers(layout, traversal_id, rows, regions, skipped, configuration, workers=options.workers, shards=in_shards)
    report.written.append(traversal_id)
    report.images += len(rows)
    for key, found in regions.items():
        report.redacted += bool(found)
        report.regions.update(f"{one.kind}/{one.origin}" for one in found)
        report.skipped.update(skipped[key])


def _repeat(
    traversal_id: str,
    tasks: Sequence[DetectionTask],
    regions: dict[ImageKey, list[Region]],
    options: DeidentifyOptions,
    configuration: Configuration,
    pool: DetectionPool,
    folder: Path,
    hashes: ContentHashes,
) -> dict[ImageKey, Failure]:
    """Search the redacted images again and add what is found, until nothing is: a redaction changes what is around it.

    An image without regions stays as it was searched before. `mirror release check` repeats the same search.

    Returns:
        The images that failed.
    """
    failures: dict[ImageKey, Failure] = {}
    changed = {task.key for task in tasks if regions[task.key] and not task.is_skipped}
    for number in range(options.propagation.repeats):
        again = [
            replace(task, regions=tuple(regions[task.key]), redaction=options.redaction)
            for task in tasks
            if task.key in changed
        ]
        log = DetectionLog(folder / f"{traversal_id}.{configuration.sha256[:16]}.{number + 1}.jsonl")
        searched, failed = detect_images(again, pool, log, hashes, lambda steps: None)
        failures |= failed
        if failed and not options.withhold_failed:
            break
        changed = set()
        for task in (task for task in again if task.key not in failed):
            size = task.row["width_px"], task.row["height_px"]
            boxes = [grown_box(one, options.redaction.grow, *size) for one in regions[task.key]]
            covering = [box for box in boxes if box is not None]
            more = [one for one in searched[task.key].regions if covered_share(one.box_px, covering) < _COVERED]
            if more:
                regions[task.key] += [one.moved_to(one.box_px, "repeat") for one in merged(more)]
                changed.add(task.key)
        if not changed:
            break
    return failures


def _named(traversal_id: str, failures: Mapping[ImageKey, Failure]) -> list[ImageFailure]:
    return [
        ImageFailure(traversal_id, camera, timestamp_ns, one.status, one.problem)
        for (camera, timestamp_ns), one in sorted(failures.items())
    ]


def _tasks(layout: Layout, dataset: Dataset, traversal_id: str, options: DeidentifyOptions) -> list[DetectionTask]:
    gone = group_by_traversal(read_take_downs(dataset.store)).get(traversal_id, frozenset())
    rows = drop_images(read_table(layout.recorded(traversal_id) / "images.parquet", IMAGES), gone).to_pylist()
    ego, sky = _ego_masks(layout, dataset, traversal_id), _sky_masks(layout, traversal_id)
    objects = visible_objects(dataset, traversal_id) if options.skip.without_boxes else {}
    tasks = []
    for row in rows:
        key = (row["camera"], row["timestamp_ns"])
        ego_mask, sky_mask = used_masks(options.skip, ego.get(row["camera"]), sky.get(key))
        task = DetectionTask(key, row, ego_mask, sky_mask)
        tasks.append(replace(task, is_skipped=options.skip.without_boxes and objects.get(key) == 0))
    return tasks


def _ego_masks(layout: Layout, dataset: Dataset, traversal_id: str) -> dict[str, str]:
    rig_id = dataset.where(traversal=traversal_id).table("traversals", ["rig_id"]).column(0)[0].as_py()
    if rig_id is None:
        return {}
    rig = dataset.store.json(f"rigs/{rig_id}.json", Rig)
    return {one.name: f"rigs/{one.static_mask}" for one in rig.cameras if one.static_mask is not None}


def _sky_masks(layout: Layout, traversal_id: str) -> dict[ImageKey, str]:
    found: dict[ImageKey, str] = {}
    for kind, source, version in layout.layers(traversal_id):
        if kind != "masks":
            continue
        table = read_table(layout.layer(traversal_id, kind, source, version) / "masks.parquet", MASKS)
        rows: list[dict[str, Any]] = table.filter(pc.equal(table.column("kind").cast("string"), "sky")).to_pylist()
        found.update({(row["camera"], row["timestamp_ns"]): row["uri"] for row in rows})
    return found
