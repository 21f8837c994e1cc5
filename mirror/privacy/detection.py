"""Detection in the recorded images of one traversal, with results that survive an interruption."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import Field

from mirror.arrays import Bool, UInt8
from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.images.decoding import decode_grey, decode_rgb
from mirror.dataset.images.metadata import read_orientation
from mirror.dataset.images.video_decoders import VideoDecoders
from mirror.dataset.store import Store
from mirror.errors import DatasetError
from mirror.executors.executor import Executor
from mirror.executors.job import Failure, ParallelJob
from mirror.executors.processes import ProcessesExecutor
from mirror.privacy.detectors.protocol import Detector, TiledDetector
from mirror.privacy.detectors.registry import DetectorChoice
from mirror.privacy.encoding import Codec, RedactedImage, redact_encoded, redact_frame, to_stored, turn_upright
from mirror.privacy.operators import Redaction
from mirror.privacy.options import SkipRules
from mirror.privacy.regions import Region
from mirror.schema.documents import Document
from mirror.schema.finished_work import FinishedWork, hash_values

ImageKey = tuple[str, int]
"""Camera and timestamp_ns."""


@dataclass(frozen=True)
class DetectionTask:
    """One recorded image to be searched.

    Attributes:
        key: camera and timestamp_ns.
        row: its row of the recorded images table.
        ego_mask: static mask of the camera, relative to the dataset's root; None: there is none, or it is not used.
        sky_mask: mask of the sky; likewise.
        is_skipped: no detector searches it.
        regions: regions that are removed before the search.
        redaction: how they are removed; None: the recorded image is searched.
    """

    key: ImageKey
    row: Mapping[str, Any]
    ego_mask: str | None = None
    sky_mask: str | None = None
    is_skipped: bool = False
    regions: tuple[Region, ...] = ()
    redaction: Redaction | None = None


class Detected(Document):
    """The regions that the detectors found in an image.

    Attributes:
        camera: the camera.
        timestamp_ns: mid-exposure.
        sha256: SHA-256 of the recorded bytes, in hexadecimal.
        regions: regions in the stored raster.
        skipped: number of tiles that were not searched, by the rule; for ``boxes``, 1: the image was not searched.
    """

    camera: str
    timestamp_ns: int
    sha256: str
    regions: tuple[Region, ...] = ()
    skipped: dict[str, int] = Field(default_factory=dict)

    @property
    def key(self) -> ImageKey:
        """Camera and timestamp_ns."""
        return self.camera, self.timestamp_ns


class DetectionLog(FinishedWork[Detected]):
    """The detections of a traversal so far; each is reused for equal bytes, masks and regions.

    Args:
        path: the file; it need not exist.

    Raises:
        DatasetError: a line is broken.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, Detected.model_validate, sync=True)


class DetectionPool:
    """The processes that search images of a dataset; they end with the block that opened the pool.

    An image whose search ends its process or takes too long fails alone; it is not searched again.

    Args:
        root: the dataset's folder.
        choices: the detectors.
        executor: where they run.
        timeout_s: longest time for one image.
    """

    def __init__(self, root: Path, choices: Sequence[DetectorChoice], executor: Executor, timeout_s: float) -> None:
        self._executor = executor
        self._job: ParallelJob[DetectionTask, Detected] = ParallelJob(
            make_search, (str(root), tuple(choices)), attempts=1, timeout_s=timeout_s
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.close()

    def map(self, tasks: Sequence[DetectionTask]) -> Iterator[tuple[int, Detected | Failure]]:
        """Yield the number of each task with its result, in the order of completion."""
        return self._executor.map(self._job, tasks)


def detection_pool(root: Path, choices: Sequence[DetectorChoice], *, workers: int, timeout_s: float) -> DetectionPool:
    """Open the processes that search images of a dataset.

    Args:
        root: the dataset's folder.
        choices: the detectors.
        workers: number of processes.
        timeout_s: longest time for one image.
    """
    return DetectionPool(root, choices, ProcessesExecutor(workers), timeout_s)


def detect_images(
    tasks: Sequence[DetectionTask],
    pool: DetectionPool,
    log: DetectionLog,
    hashes: ContentHashes,
    advance: Callable[[int], object],
) -> tuple[dict[ImageKey, Detected], dict[ImageKey, Failure]]:
    """Search images; images that the log already holds, with the same bytes, are not searched again.

    Args:
        tasks: the images.
        pool: processes with the detectors.
        log: takes the results.
        hashes: hashes images and masks.
        advance: called with the number of images done since the last call.

    Returns:
        What was found, by image, and the images that failed: unreadable ones, and those on which a detector failed,
        crashed or hung.

    Raises:
        DatasetError: a mask cannot be read, or the log cannot be written.
    """
    found: dict[ImageKey, Detected] = {}
    waiting = []
    for task in tasks:
        known = log.find(_item(task.key), partial(_hash_task, task, hashes))
        if known is None:
            waiting.append(task)
        else:
            found[task.key] = known
    advance(len(found))
    failures: dict[ImageKey, Failure] = {}
    for number, answer in pool.map(waiting):
        task = waiting[number]
        if isinstance(answer, Failure):
            failures[task.key] = answer
        else:
            inputs = hash_values(answer.sha256, _hash_conditions(task, hashes))
            log.add(_item(task.key), inputs, answer.model_dump(mode="json"), answer)
            found[task.key] = answer
        advance(1)
    return found, failures


def _item(key: ImageKey) -> str:
    return f"{key[0]}/{key[1]}"


def _hash_task(task: DetectionTask, hashes: ContentHashes) -> str:
    return hash_values(hashes.image_bytes(task.row), _hash_conditions(task, hashes))


def _hash_conditions(task: DetectionTask, hashes: ContentHashes) -> str:
    """Hash everything but the image's bytes that decides what is found in it."""
    masks = [None if path is None else hashes.file(path) for path in (task.ego_mask, task.sky_mask)]
    regions = [region.model_dump(mode="json") for region in task.regions]
    redaction = None if task.redaction is None else asdict(task.redaction)
    return hash_values(masks, task.is_skipped, regions, redaction, task.row["codec"], task.row["video_pts"])


def make_search(root: str, choices: Sequence[DetectorChoice]) -> Callable[[DetectionTask], Detected]:
    """Make the function that searches an image in a worker process."""
    store, detectors = Store(root), [choice.make() for choice in choices]
    videos, masks = VideoDecoders(store), _MaskReader(store)

    def search(task: DetectionTask) -> Detected:
        data = read_recorded(store, task.row)
        if task.redaction is None:
            pixels = decode_recorded(store, videos, task.row, data)
        else:
            redacted = redact_recorded(store, videos, task.row, data, task.regions, task.redaction)
            pixels = require_pixels(store, task.row, decode_rgb(redacted.data, out_codec(task.row)))
        camera, timestamp_ns = task.key
        digest = hashlib.sha256(data).hexdigest()
        if task.is_skipped:
            return Detected(camera=camera, timestamp_ns=timestamp_ns, sha256=digest, skipped={"boxes": 1})
        orientation = read_orientation(data) if task.row["codec"] == "jpeg" else 1
        skipped = masks.skipped(task, pixels.shape[:2])
        regions, counts = search_upright(pixels, orientation, detectors, skipped)
        return Detected(camera=camera, timestamp_ns=timestamp_ns, sha256=digest, regions=tuple(regions), skipped=counts)

    return search


def search_upright(
    pixels: UInt8, orientation: int, detectors: Iterable[Detector], skipped: Bool | None
) -> tuple[list[Region], dict[str, int]]:
    """Run detectors on an image turned upright, and map the found regions to the stored raster.

    Args:
        pixels: (H, W, 3) stored raster, RGB.
        orientation: EXIF orientation, 1 to 8.
        detectors: the detectors.
        skipped: (H, W) pixels of the stored raster that need no search; None: all do.

    Returns:
        The regions, ordered, and the number of tiles that were not searched.
    """
    upright = turn_upright(pixels, orientation)
    mask = None if skipped is None else turn_upright(skipped.astype(np.uint8), orientation) > 0
    regions: list[Region] = []
    tiles = 0
    for detector in detectors:
        if isinstance(detector, TiledDetector):
            detector.skipped, detector.skipped_tiles = mask, 0
        found = detector(upright)
        tiles += detector.skipped_tiles if isinstance(detector, TiledDetector) else 0
        regions += [to_stored(one, orientation, pixels.shape[1], pixels.shape[0]) for one in found]
    regions.sort(key=lambda one: (one.kind, one.source, *one.box_px, one.score))
    return regions, {"tiles": tiles} if tiles else {}


def read_recorded(store: Store, row: Mapping[str, Any]) -> bytes:
    """Read the recorded bytes of an image; for a frame of a video, the bytes of the whole video.

    Raises:
        DatasetError: they are missing, too few, or not those that were recorded.
    """
    try:
        data = store.read_range(row["uri"], row["byte_offset"], row["byte_length"])
    except OSError as error:
        raise _unreadable(store, row, f"cannot be read: {error.strerror or error}") from error
    if len(data) != row["byte_length"]:
        raise _unreadable(store, row, f"{len(data)} bytes; expected {row['byte_length']}")
    if row["sha256"] is not None and hashlib.sha256(data).digest() != row["sha256"]:
        raise _unreadable(store, row, "the bytes are not those that were recorded")
    return data


def decode_recorded(store: Store, videos: VideoDecoders, row: Mapping[str, Any], data: bytes) -> UInt8:
    """Decode a recorded image to its stored raster (H, W, 3), RGB.

    Raises:
        DatasetError: it cannot be decoded.
    """
    if row["codec"] == "video":
        try:
            pixels = videos.decode(row["uri"], row["video_pts"])
        except OSError as error:
            raise _unreadable(store, row, f"cannot be opened: {error.strerror or error}") from error
    else:
        pixels = decode_rgb(data, row["codec"])
    return require_pixels(store, row, pixels)


def redact_recorded(
    store: Store,
    videos: VideoDecoders,
    row: Mapping[str, Any],
    data: bytes,
    regions: Sequence[Region],
    how: Redaction,
) -> RedactedImage:
    """Redact a recorded image; a frame of a video becomes a JPEG.

    Raises:
        DatasetError: it cannot be decoded.
    """
    file = str(store.full_path(row["uri"]))
    if row["codec"] == "video":
        return redact_frame(decode_recorded(store, videos, row, data), regions, how, file)
    return redact_encoded(data, row["codec"], regions, how, file)


def out_codec(row: Mapping[str, Any]) -> Codec:
    """Return the codec of the redacted version of a recorded image."""
    return "png" if row["codec"] == "png" else "jpeg"


def require_pixels(store: Store, row: Mapping[str, Any], pixels: UInt8 | None) -> UInt8:
    """Return the decoded pixels.

    Raises:
        DatasetError: there are none.
    """
    if pixels is None:
        raise _unreadable(store, row, "the image cannot be decoded")
    return pixels


class _MaskReader:
    """Static and sky masks; the static one of each camera is kept."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._ego: dict[str, Bool] = {}

    def skipped(self, task: DetectionTask, shape: tuple[int, ...]) -> Bool | None:
        """Pixels (H, W) that need no search; None: all do."""
        parts = []
        if task.ego_mask is not None:
            if task.ego_mask not in self._ego:
                self._ego[task.ego_mask] = self._read(task.ego_mask)
            parts.append(self._ego[task.ego_mask])
        if task.sky_mask is not None:
            parts.append(self._read(task.sky_mask))
        fitting = [part for part in parts if part.shape == tuple(shape)]
        return np.logical_or.reduce(fitting) if fitting else None

    def _read(self, path: str) -> Bool:
        mask = decode_grey(self._store.read(path))
        if mask is None:
            raise DatasetError(
                "the mask cannot be decoded",
                file=self._store.full_path(path),
                remedy=f"`mirror check {self._store}` lists what is damaged: restore it",
            )
        return np.asarray(mask > 0)


def _unreadable(store: Store, row: Mapping[str, Any], problem: str) -> DatasetError:
    return DatasetError(
        problem,
        file=store.full_path(row["uri"]),
        place=f"camera {row['camera']}, timestamp_ns {row['timestamp_ns']}",
        expected="the image as it was recorded",
        remedy="restore the file, or leave the image out with --withhold-failed",
    )


def used_masks(rules: SkipRules, ego: str | None, sky: str | None) -> tuple[str | None, str | None]:
    """Return the masks that the rules use."""
    return ego if rules.ego else None, sky if rules.sky else None
