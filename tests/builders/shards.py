"""A dataset of image files, made into one whose images lie in shards, as `mirror ingest --images shards` has it."""

from __future__ import annotations

from collections.abc import Callable

import pyarrow as pa

from mirror.dataset.images.shards import SHARD_BYTES, pack_images
from mirror.dataset.index import build_index
from mirror.dataset.layout import Layout, manifest_sha256, read_manifest, seal
from mirror.schema.documents import ImageTotals
from mirror.schema.files import encode_table, read_table, write_bytes
from mirror.schema.tables import IMAGES


def put_into_shards(layout: Layout, limit_bytes: int = SHARD_BYTES) -> None:
    """Move the recorded images of every traversal into shards, and derive the index again.

    Args:
        layout: the dataset.
        limit_bytes: size beyond which a frame begins the next shard.
    """

    def pack(images: pa.Table, folder: str) -> pa.Table:
        return pack_images(images, layout.root, folder, limit_bytes=limit_bytes)

    rewrite_images(layout, pack)


def rewrite_images(layout: Layout, change: Callable[[pa.Table, str], pa.Table]) -> None:
    """Give every traversal another table of recorded images, and derive the index again.

    Args:
        layout: the dataset.
        change: called with a table and the folder of its traversal's recording, relative to the dataset.
    """
    for drive_id in layout.drive_ids():
        drive = layout.drive(drive_id)
        manifest = read_manifest(drive)
        assert manifest is not None
        derived = dict(manifest.derived_from)
        for key in derived:
            if not key.startswith("traversal:"):
                continue
            traversal_id = key.removeprefix("traversal:")
            folder = layout.recorded(traversal_id)
            place = folder.relative_to(layout.root).as_posix()
            rows = read_table(folder / "images.parquet", IMAGES)
            packed = change(rows, place)
            write_bytes(folder / "images.parquet", encode_table(packed, IMAGES))
            old = read_manifest(folder)
            assert old is not None
            files = {name: (folder / name).read_bytes() for name in old.files}
            totals = ImageTotals(count=packed.num_rows, bytes=sum(packed.column("byte_length").to_pylist()))
            seal(folder, files, derived_from=old.derived_from, images=totals)
            derived[key] = manifest_sha256(folder)
        seal(drive, {name: (drive / name).read_bytes() for name in manifest.files}, derived_from=derived)
    build_index(layout.root)
