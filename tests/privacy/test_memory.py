"""Writing the layers of a traversal keeps a few images in memory, however many there are."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

from mirror.dataset.layout import Layout
from mirror.privacy.operators import Redaction
from mirror.privacy.regions import region_at
from mirror.privacy.writing import Configuration, write_layers
from mirror.schema.files import read_table
from mirror.schema.tables import IMAGES
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass
from tests.privacy.images import jpeg, pixels

WIDTH, HEIGHT = 480, 320


def peak_bytes(root: Path, frames: int) -> int:
    """The most memory that writing the layers of so many images takes at once."""
    builder = Builder(root, cameras=("front_wide",), size=(WIDTH, HEIGHT))
    builder.scene("a")
    images = {"front_wide": jpeg(pixels(HEIGHT, WIDTH))}
    (name,) = builder.drive("d", [Pass("a", EPOCH, frames=frames, frame_ns=12 * SECOND // frames, images=images)])
    layout = Layout(root)
    table = read_table(layout.recorded(name) / "images.parquet", IMAGES).to_pylist()
    rows = {(row["camera"], row["timestamp_ns"]): row for row in table}
    assert len(rows) == frames
    regions = {key: [region_at((40.0, 40.0, 90.0, 60.0), "plate")] for key in rows}
    tracemalloc.start()
    try:
        write_layers(layout, name, rows, regions, {}, Configuration("1", "0" * 64, (), Redaction()), workers=1)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_does_not_grow_with_the_number_of_images(tmp_path: Path) -> None:
    few, many = (peak_bytes(tmp_path / str(frames), frames) for frames in (12, 60))
    assert few > WIDTH * HEIGHT * 3
    assert many < few + 4 * WIDTH * HEIGHT * 3
