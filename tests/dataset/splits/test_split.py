"""Splits on disk: made, kept, extended, refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mirror.dataset.layout import Layout
from mirror.dataset.lock import writer_lock
from mirror.dataset.splits import extend_split, make_split
from mirror.dataset.splits.candidates import read_candidates
from mirror.dataset.splits.leaks import find_leaks, find_ties, overlapping_scenes
from mirror.errors import DatasetError, UsageError
from mirror.schema.documents import ByCondition, ByScene, LightAndWeather, NovelTraversal, Roi
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass

FIVE = ("d0", "d1", "d2", "d3", "d4")
IMAGE = {"front_wide": b"one and the same image"}


def fill(builder: Builder, scene: str, drives: tuple[str, ...], start_s: int = 0, **more: object) -> None:
    for number, drive in enumerate(drives):
        entry = EPOCH + (start_s + 100 * number) * SECOND
        builder.drive(drive, [Pass(scene, entry_ns=entry, frames=2, **more)], vehicle_id=f"car_{drive}")  # type: ignore[arg-type]


@pytest.fixture
def builder(tmp_path: Path) -> Builder:
    made = Builder(tmp_path / "data", cameras=("front_wide",))
    made.scene("a")
    fill(made, "a", FIVE)
    return made


def read(builder: Builder, name: str = "s") -> bytes:
    return builder.layout.split(name).read_bytes()


def test_a_split_is_made_and_frozen(builder: Builder) -> None:
    report = make_split(builder.root, "s")
    assert report.action == "made"
    assert report.roles() == {"train": 4, "held_out": 1}
    document = json.loads(read(builder))
    assert document["parameters"] == {"method": "novel-traversal", "train": 4, "held_out": 1}
    assert len(document["dataset_hash"]) == 64

    before = read(builder)
    fill(builder, "a", ("e0", "e1"), start_s=10_000)
    again = make_split(builder.root, "s")
    assert again.action == "kept"
    assert again.changed == ()
    assert {key.split(".")[1] for key in again.outside} == {"e0", "e1"}
    assert read(builder) == before


def test_it_is_the_same_whatever_the_order_of_ingest(builder: Builder, tmp_path: Path) -> None:
    other = Builder(tmp_path / "other", cameras=("front_wide",))
    other.scene("a")
    for number in (3, 0, 4, 1, 2):
        entry = EPOCH + 100 * number * SECOND
        drive = FIVE[number]
        other.drive(drive, [Pass("a", entry_ns=entry, frames=2)], vehicle_id=f"car_{drive}")
    make_split(builder.root, "s", seed=5)
    make_split(other.root, "s", seed=5)
    assert read(builder) == read(other)


def test_extend_puts_what_came_in_train(builder: Builder) -> None:
    first = make_split(builder.root, "s").document
    fill(builder, "a", ("e0", "e1"), start_s=10_000)
    report = extend_split(builder.root, "s")
    assert report.action == "extended"
    assert {key: report.document.assignments[key] for key in first.assignments} == first.assignments
    assert {report.document.assignments[key] for key in report.document.added} == {"train"}
    assert len(report.document.added) == 2
    assert report.document.dataset_hash != first.dataset_hash
    assert make_split(builder.root, "s").outside == ()
    before = read(builder)
    assert extend_split(builder.root, "s").action == "kept"
    assert read(builder) == before


def test_extend_leaves_out_what_would_leak(builder: Builder) -> None:
    roles = make_split(builder.root, "s").document.assignments
    held = next(key for key, role in roles.items() if role == "held_out")
    drive, entry_ms = held.split(".")[1:]
    # Another recorder in the held-out vehicle ran at the same time.
    entry = int(entry_ms) * 1_000_000 + 50_000_000
    builder.drive("second_recorder", [Pass("a", entry_ns=entry, frames=2)], vehicle_id=f"car_{drive}")
    document = extend_split(builder.root, "s").document
    added = document.added[0]
    assert document.assignments[added] == "unused"
    assert (
        f"{added} and {held} (held_out) are of one vehicle, car_{drive}, at the same time" in document.left_out[added]
    )


def test_extend_by_condition_trains_only_on_what_fits(builder: Builder) -> None:
    fill(builder, "a", ("n0",), start_s=20_000, light="night")
    parameters = ByCondition(train=(LightAndWeather(light="day"),), test=(LightAndWeather(light="night"),))
    make_split(builder.root, "s", parameters)
    fill(builder, "a", ("day2",), start_s=30_000)
    fill(builder, "a", ("night2",), start_s=40_000, light="night")
    document = extend_split(builder.root, "s").document
    roles = {key.split(".")[1]: role for key, role in document.assignments.items()}
    assert (roles["day2"], roles["night2"], roles["n0"]) == ("train", "unused", "test")


def test_other_parameters_need_another_name_or_replace(builder: Builder) -> None:
    make_split(builder.root, "s")
    before = read(builder)
    for more in ({"parameters": NovelTraversal(train=3)}, {"seed": 1}, {"scenes": ["a"]}):
        with pytest.raises(DatasetError, match="a split of this name was made with other") as caught:
            make_split(builder.root, "s", **more)  # type: ignore[arg-type]
        assert "--replace" in str(caught.value)
    assert read(builder) == before
    assert make_split(builder.root, "s", NovelTraversal(train=3), replace=True).roles() == {
        "train": 3, "held_out": 1, "unused": 1,
    }  # fmt: skip


def test_scenes_with_too_few_are_listed_or_refused(builder: Builder) -> None:
    builder.scene("b", longitude_deg=-79.5)
    fill(builder, "b", ("x", "y"), start_s=5000)
    left_out = make_split(builder.root, "s").document.left_out
    assert left_out == {"b": "2 traversals, but 4 to train on and 1 to hold out needed"}
    with pytest.raises(DatasetError, match="b: 2 traversals, but 4"):
        make_split(builder.root, "t", require=True)
    with pytest.raises(DatasetError, match="no traversal gets a role"):
        make_split(builder.root, "t", scenes=["b"])
    assert not builder.layout.split("t").exists()


def test_the_same_image_in_two_drives_stays_in_one_role(tmp_path: Path) -> None:
    builder = Builder(tmp_path, cameras=("front_wide",))
    builder.scene("a")
    fill(builder, "a", FIVE)
    fill(builder, "a", ("copy0", "copy1"), start_s=1000, images=IMAGE)
    for seed in range(8):
        document = make_split(builder.root, f"s{seed}", NovelTraversal(train=6), seed=seed).document
        roles = {key.split(".")[1]: role for key, role in document.assignments.items()}
        assert roles["copy0"] == roles["copy1"] == "train"
    found = find_ties(read_candidates(builder.layout), by_scene=False)
    assert [tie.kind for tie in found] == ["bytes"]
    assert "have the same bytes in 1 image, " in found[0].reason
    with pytest.raises(DatasetError, match=r"c\.copy2\.\d+ and c\.copy3\.\d+"):
        builder.scene("c", longitude_deg=-79.6)
        fill(builder, "c", ("copy2", "copy3"), start_s=4000, images=IMAGE)
        make_split(builder.root, "t", NovelTraversal(train=1), scenes=["c"])


def test_overlapping_scenes_stay_together(tmp_path: Path) -> None:
    builder = Builder(tmp_path, cameras=("front_wide",))
    # One degree of longitude is 80.6 km here: 0.004 degrees are 323 m, 0.01 degrees 806 m.
    for number, longitude in enumerate((-79.400, -79.396, -79.300, -79.200)):
        builder.scene(f"s{number}", longitude_deg=longitude)
        fill(builder, f"s{number}", (f"d{number}",), start_s=1000 * number)
    halves = ByScene(train=0.5, val=0, test=0.5)
    for seed in range(8):
        document = make_split(builder.root, f"n{seed}", halves, seed=seed).document
        roles = {key.split(".")[0]: role for key, role in document.assignments.items()}
        assert roles["s0"] == roles["s1"]
        assert set(roles.values()) == {"train", "test"}
    with pytest.raises(DatasetError, match=r"s0\.d0.* and s1\.d1"):
        make_split(builder.root, "t", halves, scenes=["s0", "s1"])


def test_scenes_overlap_closer_than_both_radii() -> None:
    def local(x: float, radius: float, name: str) -> Roi:
        return Roi(scene_id=name, frame="city", x_m=x, y_m=0.0, radius_m=radius)

    rois = [local(0, 100, "a"), local(250, 150, "b"), local(249.999, 150, "c"), local(0, 1, "d").model_copy(
        update={"frame": "elsewhere"})]  # fmt: skip
    assert {(one.scene_id, two.scene_id) for one, two, _ in overlapping_scenes(rois)} == {("a", "c"), ("b", "c")}


def test_a_split_edited_by_hand_is_seen_to_leak(builder: Builder) -> None:
    builder.scene("b", longitude_deg=-79.5)
    entry = EPOCH + 7000 * SECOND
    builder.drive("both", [Pass("a", entry_ns=entry), Pass("b", entry_ns=entry + 60 * SECOND)], vehicle_id="x")
    found = find_ties(read_candidates(builder.layout), by_scene=False)
    roles = dict(zip(found[0].members, ("train", "held_out")))
    assert len(find_leaks(found, roles)) == 1
    text = str(find_leaks(found, roles)[0])
    assert text == f"{found[0].members[0]} (train) and {found[0].members[1]} (held_out) are of one drive, both"


def test_recorded_again_is_seen(builder: Builder) -> None:
    make_split(builder.root, "s")
    builder.drive("d2", [Pass("a", entry_ns=EPOCH + 200 * SECOND, frames=3)], vehicle_id="car_d2")
    assert [key.split(".")[1] for key in make_split(builder.root, "s").changed] == ["d2"]
    with pytest.raises(DatasetError, match="of the split have changed"):
        extend_split(builder.root, "s")


@pytest.mark.parametrize("name", ["", "../s", "a/b", "a b", "."])
def test_bad_names(builder: Builder, name: str) -> None:
    with pytest.raises(UsageError, match="not a valid name"):
        make_split(builder.root, name)


def test_usage(builder: Builder, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="unknown scene 'nowhere'"):
        make_split(builder.root, "s", scenes=["nowhere"])
    with pytest.raises(DatasetError, match="no such split"):
        extend_split(builder.root, "s")
    with pytest.raises(DatasetError, match="the folder does not exist"):
        make_split(tmp_path / "elsewhere", "s")
    assert not (tmp_path / "elsewhere").exists()
    with writer_lock(Layout(builder.root), wait=False), pytest.raises(DatasetError, match="another run"):
        make_split(builder.root, "s")


def test_an_empty_dataset_has_nothing_to_split(tmp_path: Path) -> None:
    builder = Builder(tmp_path, cameras=("front_wide",))
    builder.scene("a")
    with pytest.raises(DatasetError, match="the dataset has no traversals"):
        make_split(builder.root, "s")


def test_the_loader_reads_the_roles(builder: Builder) -> None:
    from mirror.dataset.dataset import open as open_dataset
    from mirror.dataset.index import build_index

    roles = make_split(builder.root, "s").document.assignments
    build_index(builder.root)
    held = open_dataset(builder.root).where(split="s", role="held_out").traversals()
    assert held == [key for key, role in roles.items() if role == "held_out"]
