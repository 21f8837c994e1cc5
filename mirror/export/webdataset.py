"""WebDataset: tar files with one sample for each frame, for loaders that read a dataset as a stream.

The members of a sample share a key: ``<key>.<camera>.jpg``, ``<key>.<camera>.mask.png`` and ``<key>.json`` with ids,
poses, lenses, exposures and boxes. Samples of a traversal follow each other in time. With a split, a shard holds the
samples of one role, and its name begins with it. Shards have equal bytes wherever they are made.

Source: https://github.com/webdataset/webdataset (a key ends at the first dot of a file's name).
"""

from __future__ import annotations

import filecmp
import io
import json
import os
import re
import tarfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from mirror.dataset.frames import Frame
from mirror.export.files import encode_image, image_bytes
from mirror.export.layout import ExportLayout, Kept, Written
from mirror.export.samples import describe_frame, own_lens
from mirror.export.scene import ExportImage, ExportScene
from mirror.progress import ProgressReporter
from mirror.schema.files import TEMPORARY, unwritable_error

SHARD_BYTES: Final = 256 * 1024 * 1024
"""A shard ends with the sample that reaches this size of recorded images."""

Sample = tuple[Frame, list[ExportImage]]


class _Shard(NamedTuple):
    """Counts of what a shard holds."""

    masks: int
    boxes: int


def sample_key(item: ExportImage) -> str:
    """Return the key of the sample that an image belongs to."""
    name = re.sub(r"[^A-Za-z0-9_-]", "_", item.frame.traversal_id)
    return f"{name}-{item.frame.frame_index:06}"


def _image_path(item: ExportImage) -> str:
    return f"{sample_key(item)}.{item.image.camera}{item.suffix}"


def _write(scene: ExportScene, out: Path, progress: ProgressReporter) -> Written:
    progress.start("samples", len(list(scene.by_frame())))
    files, boxes, masks = [], 0, 0
    for name, samples in _shards(scene):
        path = out / name
        more = _write_shard(scene, path, samples, progress)
        masks, boxes = masks + more.masks, boxes + more.boxes
        files.append(path)
    return Written(tuple(files), boxes=boxes, masks=masks)


def _shards(scene: ExportScene) -> Iterator[tuple[str, list[Sample]]]:
    """Names and samples of the shards: by role, then in order of traversals and frames."""
    by_role: dict[str, list[Sample]] = {}
    for frame, images in scene.by_frame():
        by_role.setdefault(images[0].role or "all", []).append((frame, images))
    for role, samples in by_role.items():
        number, size, shard = 0, 0, list[Sample]()
        for sample in samples:
            shard.append(sample)
            size += sum(item.image.byte_length for item in sample[1])
            if size >= SHARD_BYTES:
                yield f"{role}-{number:06}.tar", shard
                number, size, shard = number + 1, 0, []
        if shard:
            yield f"{role}-{number:06}.tar", shard


def _write_shard(scene: ExportScene, path: Path, samples: Sequence[Sample], progress: ProgressReporter) -> _Shard:
    """Write a shard under a temporary name, in place of one of an earlier call."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY}")
    masks = boxes = 0
    try:
        with tarfile.open(temporary, "w", format=tarfile.USTAR_FORMAT) as tar:
            for frame, images in samples:
                for item in images:
                    _add(tar, _image_path(item), image_bytes(item, item.suffix))
                    valid = item.valid_pixels()
                    if valid is not None:
                        _add(tar, f"{sample_key(item)}.{item.image.camera}.mask.png", encode_image(valid, ".png"))
                        masks += 1
                described = describe_frame(scene, frame, images)
                boxes += len(described["boxes"])
                _add(tar, f"{sample_key(images[0])}.json", json.dumps(described).encode())
                progress.advance(1)
        if not (path.is_file() and filecmp.cmp(temporary, path, shallow=False)):
            temporary.replace(path)
    except OSError as error:
        raise unwritable_error(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)
    return _Shard(masks, boxes)


def _add(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(data)
    tar.addfile(member, io.BytesIO(data))


LAYOUT: Final = ExportLayout(
    name="webdataset",
    title="WebDataset shards, one sample for each frame",
    lens_of=own_lens,
    image_path=_image_path,
    mask_path=None,
    needs_all_masks=False,
    write=_write,
    holds_images=True,
    kept=(
        Kept("bytes of each image", "<camera>.jpg", "exact; frames of videos become PNG"),
        Kept("pose of the vehicle and of each image", "json", "exact"),
        Kept("lenses of every model, mountings", "json", "exact"),
        Kept("exposure, rolling shutter", "json", "exact"),
        Kept("pose, size, velocity, score, tracks, category, attributes of boxes", "json", "exact"),
        Kept("masks of what is not the static street", "<camera>.mask.png", "exact"),
        Kept("traversal, drive, frame, time, light, weather", "json", "exact"),
        Kept("roles of a split", "names of the shards", "exact"),
    ),
    lost=(
        "depth maps and points",
        "lidar sweeps",
        "the geodetic reference of the world frame",
        "calibration stages, validity and covariance",
        "poses between images",
    ),
)
