"""Clips and their folder."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from hybridworldsim.generation.clips.clip import Clip, ClipBoxes
from hybridworldsim.generation.clips.folder import clip_path, read_clip, read_list, write_clip
from mirror.errors import DatasetError
from tests.generation.clips import make_clip, write_clips


def test_clips_are_read_as_they_were_written(tmp_path: Path) -> None:
    for clip in (make_clip(), replace(make_clip("clip-1"), tracks=None)):
        write_clip(tmp_path, clip)
        read = read_clip(tmp_path, clip.clip_id)
        for field in fields(Clip):
            if field.name != "boxes":
                np.testing.assert_array_equal(getattr(read, field.name), getattr(clip, field.name))
        for field in fields(ClipBoxes):
            np.testing.assert_array_equal(getattr(read.boxes, field.name), getattr(clip.boxes, field.name))


def test_an_incomplete_folder_is_refused(tmp_path: Path) -> None:
    write_clip(tmp_path, make_clip())
    with pytest.raises(DatasetError, match=r"no clips\.json"):
        read_list(tmp_path)
    assert read_list(write_clips(tmp_path)).training == ("clip-0", "clip-1")


def test_broken_clips_are_refused(tmp_path: Path) -> None:
    write_clip(tmp_path, make_clip())
    path = clip_path(tmp_path, "clip-0")
    for data in (b"", b"no archive", path.read_bytes()[:-200]):
        path.write_bytes(data)
        with pytest.raises(DatasetError, match="cannot be read"):
            read_clip(tmp_path, "clip-0")


@pytest.mark.parametrize("name", ["background", "boxes_track"])
def test_a_clip_without_an_array_is_refused_by_its_name(tmp_path: Path, name: str) -> None:
    write_clip(tmp_path, make_clip())
    path = clip_path(tmp_path, "clip-0")
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files if key != name}
    np.savez_compressed(path, **arrays)
    with pytest.raises(DatasetError, match=rf"cannot be read \(no {name} in it\)") as caught:
        read_clip(tmp_path, "clip-0")
    assert caught.value.file == str(path) and caught.value.remedy


def test_the_file_of_a_box_that_is_not_valid_is_named(tmp_path: Path) -> None:
    write_clip(tmp_path, make_clip())
    path = clip_path(tmp_path, "clip-0")
    with np.load(path) as file:
        arrays = dict(file)
    arrays["boxes_ego_SE3_box"][2, 0, 3] = np.nan
    np.savez_compressed(path, **arrays)
    with pytest.raises(DatasetError, match="track 3 in frame 2") as caught:
        read_clip(tmp_path, "clip-0")
    assert (caught.value.file, caught.value.place) == (str(path), "clip-0, box 2")
    assert caught.value.remedy == "leave the box out, or correct it"


@pytest.mark.parametrize(
    ("field", "row", "value"),
    [("ego_SE3_box", (2, 0, 3), np.nan), ("lwh_m", (2, 1), 0.0), ("category", 2, 7), ("frame", 2, 8)],
)
def test_boxes_that_are_not_valid_are_named(field: str, row: object, value: float) -> None:
    clip = make_clip()
    changed = getattr(clip.boxes, field).copy()
    changed[row] = value
    with pytest.raises(DatasetError, match="box 2"):
        replace(clip, boxes=replace(clip.boxes, **{field: changed}))


def test_arrays_that_do_not_fit_are_named() -> None:
    clip = make_clip()
    with pytest.raises(DatasetError, match="background of shape"):
        replace(clip, background=clip.background[:, :, :-1])
    with pytest.raises(DatasetError, match="start_SE3_ego is not finite"):
        replace(clip, start_SE3_ego=clip.start_SE3_ego * np.nan)
