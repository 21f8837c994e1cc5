"""Layers of depth maps and points: written once, read back as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mirror.dataset
from mirror.dataset.images.depth_codec import FARTHEST_M, NEAREST_M, decode_depth, encode_depth
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import read_manifest
from mirror.errors import DatasetError, UsageError
from mirror.schema.tables import POINTS
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass, write_reconstruction


def built(root: Path) -> tuple[Builder, list[str], int]:
    builder = Builder(root)
    builder.scene("a")
    ids = [
        *builder.drive("d1", [Pass("a")]),
        *builder.drive("d2", [Pass("a", EPOCH + 100 * SECOND)]),
    ]
    build_index(root)
    return builder, ids, mirror.dataset.open(root).frames()[0].images["front_wide"].timestamp_ns


@given(st.lists(st.floats(NEAREST_M, FARTHEST_M), min_size=1, max_size=20))
def test_depth_is_kept_to_a_small_share_of_itself(depths: list[float]) -> None:
    decoded = decode_depth(encode_depth(np.array([[*depths, np.nan]])))
    assert decoded is not None and np.isnan(decoded[0, -1])
    # Half a step on either side; a whole one where unknown took the first.
    np.testing.assert_allclose(decoded[0, :-1], depths, rtol=1.77e-4 if min(depths) < 0.1001 else 8.9e-5)


@pytest.mark.parametrize("bad", [0.09, 10_001.0, np.inf, -1.0, 0.0])
def test_depths_that_cannot_be_kept_are_refused(bad: float) -> None:
    with pytest.raises(UsageError, match="depths from"):
        encode_depth(np.array([[5.0, bad]]))
    with pytest.raises(UsageError, match="shape"):
        encode_depth(np.zeros((0, 4)))


@pytest.mark.parametrize("data", [b"", b"no image", encode_depth(np.ones((4, 4)))[:40]])
def test_no_depth_map_decodes_to_nothing(data: bytes) -> None:
    assert decode_depth(data) is None


def test_a_map_and_points_are_read_back(tmp_path: Path) -> None:
    builder, (first, second), stamp = built(tmp_path)
    write_reconstruction(builder, first, "front_wide", stamp)
    build_index(tmp_path)
    dataset = mirror.dataset.open(tmp_path)
    images = dataset.frames()[0].images
    depth = images["front_wide"].depth()
    assert depth is not None and images["front_left"].depth() is None
    np.testing.assert_allclose(depth.decode(), np.full((4, 6), 7.0), rtol=1e-4)
    assert (depth.lens.fx_px, depth.lens.width_px, depth.source) == (5.0, 6, "sweep")
    points = dataset.points()
    assert len(points) == 2 and points.kind == ("ground", "background") and points.traversal_id == (first, first)
    np.testing.assert_array_equal(points.position_m, [[7.0, 2.0, 3.0]] * 2)
    np.testing.assert_array_equal(points.sigma_m, np.array([0.5, np.nan], np.float32))
    assert points.rgb.dtype == np.uint8 and points.views.tolist() == [3, 4]
    assert len(dataset.where(traversal=second).points()) == 0
    assert dataset.table("depth", ["camera"]).num_rows == dataset.count("depth") == 1


def test_versions_lie_side_by_side_and_one_is_chosen(tmp_path: Path) -> None:
    builder, (first, _), stamp = built(tmp_path)
    write_reconstruction(builder, first, "front_wide", stamp)
    write_reconstruction(builder, first, "front_wide", stamp, depth_m=9.0, version="2")
    build_index(tmp_path)
    dataset = mirror.dataset.open(tmp_path)
    with pytest.raises(UsageError, match=r"depth of sweep@1, sweep@2"):
        dataset.frames()[0].images["front_wide"].depth()
    with pytest.raises(UsageError, match=r"points of sweep@1, sweep@2"):
        dataset.points()
    chosen = dataset.with_layers(depth="sweep@2", points="sweep@2")
    depth = chosen.frames()[0].images["front_wide"].depth()
    assert depth is not None and abs(float(depth.decode()[0, 0]) - 9.0) < 1e-3
    assert chosen.points().position_m[:, 0].tolist() == [9.0, 9.0]
    with pytest.raises(UsageError, match="unknown depth layer"):
        dataset.with_layers(depth="sweep@3")


def test_a_layer_is_never_overwritten_and_names_what_it_came_from(tmp_path: Path) -> None:
    builder, (first, _), stamp = built(tmp_path)
    write_reconstruction(builder, first, "front_wide", stamp)
    manifest = read_manifest(builder.layout.layer(first, "depth", "sweep", "1"))
    recorded = read_manifest(builder.layout.recorded(first))
    assert manifest is not None and recorded is not None
    assert manifest.derived_from == {"estimator": "sweep", "recorded": recorded.content}
    with pytest.raises(DatasetError, match="exists already"):
        write_reconstruction(builder, first, "front_wide", stamp)


def test_what_an_interrupted_run_left_is_replaced(tmp_path: Path) -> None:
    builder, (first, _), _ = built(tmp_path)
    LayerWriter(builder.layout, first, "points", "sweep", "1").file("left.png", b"over")
    assert builder.layout.layers(first) == []
    writer = LayerWriter(builder.layout, first, "points", "sweep", "1")
    writer.finish(POINTS, [], {})
    assert builder.layout.layers(first) == [("points", "sweep", "1")]
    assert not (writer.folder / "left.png").exists()


@pytest.mark.parametrize(("traversal", "source"), [("a.d9.1", "sweep"), (None, "../up"), (None, "a@b"), (None, "")])
def test_layers_that_cannot_be_are_refused(tmp_path: Path, traversal: str | None, source: str) -> None:
    builder, (first, _), _ = built(tmp_path)
    with pytest.raises((DatasetError, UsageError)):
        LayerWriter(builder.layout, traversal or first, "points", source, "1")


def test_a_map_of_another_size_or_broken_is_named(tmp_path: Path) -> None:
    builder, (first, _), stamp = built(tmp_path)
    write_reconstruction(builder, first, "front_wide", stamp)
    build_index(tmp_path)
    file = builder.layout.layer(first, "depth", "sweep", "1") / "map.png"
    size = len(file.read_bytes())
    for data in (encode_depth(np.full((4, 4), 7.0)), b"\0" * size):
        file.write_bytes(data + b"\0" * (size - len(data)))
        depth = mirror.dataset.open(tmp_path).frames()[0].images["front_wide"].depth()
        assert depth is not None
        with pytest.raises(DatasetError, match="depth of sweep@1"):
            depth.decode()
