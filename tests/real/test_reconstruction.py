"""Real photos through the verbs of static reconstruction, from COLMAP to scores, and invalid inputs."""

from __future__ import annotations

import csv
import json
import runpy
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

import mirror
from mirror.cli.main import main
from mirror.errors import ExitCode
from mirror.methods.training_images import list_scored_training_images
from mirror.protocols.document import load_protocol
from tests.conftest import ROOT

ROI = "13.194864,55.698894"
PROTOCOL = """
name = "every-fourth-photo"
version = 1
task = "reconstruction"
description = "Every fourth photo of a walk, held out of training; nobody is masked."
averaging = ["scene"]
groups = [{ name = "held-out", roles = ["train"] }]
frames = { first = 2, every = 4, last = false }
pixels = { space = "undistorted", max_width_px = 64 }
masks = { ego = true, dynamic = [] }
metrics = [{ metric = "psnr" }]
"""


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def walk(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of the street in Lund, made by the example script: ten photos, one second apart."""
    pytest.importorskip("pycolmap")
    whole = tmp_path_factory.mktemp("walk") / "lund"
    runpy.run_path(str(ROOT / "examples" / "lund_recording.py"))["main"](real_data / "opensfm_lund", whole)
    assert len(photos(whole)) == 29
    for photo in photos(whole)[10:]:
        photo.unlink()
    poses(whole, lambda rows: rows[:10])
    return whole


def photos(recording: Path) -> list[Path]:
    return sorted((recording / "images" / "front_wide").iterdir())


def poses(recording: Path, change: Callable[[list[list[str]]], list[list[str]]]) -> None:
    path = recording / "poses.csv"
    header, *rows = list(csv.reader(path.open()))
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header, *change(rows)])


class Street:
    """A dataset of some edited recordings; all are training recordings.

    Args:
        folder: a new folder.
        recordings: recordings to ingest.
    """

    def __init__(self, folder: Path, *recordings: Path) -> None:
        self.dataset, self.protocol = folder / "dataset", folder / "protocol.toml"
        self.protocol.write_text(PROTOCOL)
        made = (*map(str, recordings), "--roi", ROI, "--copy", "--min-duration-s", "1", "--out", str(self.dataset))
        assert main(["ingest", *made]) == ExitCode.DONE
        shares = ("--method", "by-scene", "--train", "1", "--val", "0", "--test", "0")
        assert main(["split", str(self.dataset), "all", *shares]) == ExitCode.DONE

    def __call__(self, capsys: pytest.CaptureFixture[str], verb: str, *words: object, code: int = 0) -> dict[str, Any]:
        """Run a verb and return its JSON output."""
        capsys.readouterr()
        assert main([verb, *map(str, words), "--json"]) == code
        said: dict[str, Any] = json.loads(capsys.readouterr().out)
        return said

    def reconstruct(
        self, capsys: pytest.CaptureFixture[str], out: Path, *more: object, code: int = 0
    ) -> dict[str, Any]:
        words = (self.dataset, "--split", "all", "--protocol", self.protocol, "--out", out, "--width", 64)
        return self(capsys, "reconstruct", *words, "--threads", 1, "--steps", 12, *more, code=code)


def edited(walk: Path, folder: Path, name: str = "lund") -> Path:
    """A copy of the recording that a test may change."""
    copy = folder / f"recording-{name}"
    shutil.copytree(walk, copy)
    document = json.loads((copy / "recording.json").read_text())
    (copy / "recording.json").write_text(json.dumps({**document, "drive_id": name}))
    return copy


def test_photos_of_one_walk_are_held_out_rendered_and_scored(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    street = Street(tmp_path, walk)
    dataset = mirror.open(street.dataset)
    withheld = list_scored_training_images(dataset, load_protocol(str(street.protocol)), "all", dataset.scenes()[0])
    stamps = dataset.table("images", ["timestamp_ns"]).column(0).to_pylist()
    assert sorted(stamp for _, _, stamp in withheld) == sorted(stamps)[2::4]

    done = street.reconstruct(capsys, tmp_path / "model", "--hold-out", "--initialise", "plane-sweep")
    assert done["withheld"] == 2 and done["pictures"] == 8 and done["psnr_db"] > 8.0
    run = json.loads((tmp_path / "model" / done["blocks"][0] / "run.json").read_text())
    assert {int(one.rpartition("/")[2]) for one in run["withheld"]} == {stamp for _, _, stamp in withheld}
    # Held-out images contribute neither colours nor depth.
    depth = mirror.open(street.dataset).table("depth", ["timestamp_ns"]).column(0).to_pylist()
    assert sorted(depth) == sorted(set(stamps) - {stamp for _, _, stamp in withheld})

    submission = tmp_path / "submission"
    words = ("--dataset", street.dataset, "--split", "all", "--protocol", street.protocol, "--out", submission)
    assert street(capsys, "render", tmp_path / "model", *words)["views"] == 2
    manifest = json.loads((submission / "manifest.json").read_text())
    assert manifest["method"]["trained_on"].endswith("without 2 of their pictures")
    scores = tmp_path / "scores"
    scored = (street.dataset, submission, "--protocol", street.protocol, "--out", scores)
    street(capsys, "evaluate", *scored)
    assert "psnr" in (scores / "result.json").read_text()
    assert np.isfinite(mirror_psnr(scores)).all()


def test_the_middle_frame_of_six_cameras_is_held_out_rendered_and_scored(
    real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """DGP's scene: six cameras of a van at three instants; road users are masked by boxes."""
    protocol, dataset = tmp_path / "dgp.toml", tmp_path / "dgp"
    middle = PROTOCOL.replace("frames = { first = 2, every = 4", "frames = { first = 1, every = 3")
    protocol.write_text(middle.replace("dynamic = []", 'dynamic = ["boxes"]'))
    recording, rois, short = real_data / "dgp_scene_02", tmp_path / "rois.geojson", ("--min-path-m", "1")
    seen = ("--min-traversals", "1", "--min-duration-s", "0.1", *short)
    begin = ("--split", "one", "--protocol", protocol, "--hold-out", "--width", 96, "--initialise", "plane-sweep")
    model, submission, scores = (tmp_path / name for name in ("model", "submission", "scores"))
    for words in (
        ("rois", "propose", recording, "--count", "1", *seen, "--out", rois),
        ("ingest", recording, "--rois", rois, "--min-duration-s", "0.1", *short, "--out", dataset),
        ("split", dataset, "one", "--method", "by-scene", "--train", "1", "--val", "0", "--test", "0"),
        ("reconstruct", dataset, *begin, "--steps", 40, "--threads", 1, "--out", model),
        ("render", dataset, model, "--split", "one", "--protocol", protocol, "--out", submission),
        ("evaluate", dataset, submission, "--protocol", protocol, "--out", scores),
    ):
        assert main([str(word) for word in words]) == ExitCode.DONE
    psnr = mirror_psnr(scores)
    # A constant grey image has 11 to 13 dB.
    assert len(psnr) == 6 and np.mean(psnr) > 14.0


def mirror_psnr(scores: Path) -> list[float]:
    import pyarrow.parquet

    values: list[float] = pyarrow.parquet.read_table(scores / "images.parquet").column("psnr").to_pylist()
    return values


def test_a_single_photo_is_refused(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = edited(walk, tmp_path)
    for photo in photos(copy)[1:]:
        photo.unlink()
    street = Street(tmp_path, copy)
    for method in ("plane-sweep", "sparse"):
        words = ("--initialise", method)
        said = street.reconstruct(capsys, tmp_path / method, *words, code=ExitCode.COULD_NOT_RUN)
        assert "no points" in said["problem"] and "matched no point" in said["remedy"]


def test_masks_over_everything_are_refused(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = edited(walk, tmp_path)
    cv2.imwrite(str(copy / "mask.png"), np.full((768, 1024), 255, np.uint8))
    document = json.loads((copy / "recording.json").read_text())
    document["cameras"]["front_wide"]["static_mask"] = "mask.png"
    (copy / "recording.json").write_text(json.dumps(document))
    street = Street(tmp_path, copy)
    said = street.reconstruct(capsys, tmp_path / "model", "--initialise", "plane-sweep", code=ExitCode.COULD_NOT_RUN)
    assert "no points" in said["problem"] and "masks" in said["remedy"]


def test_training_survives_black_and_duplicate_photos(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = edited(walk, tmp_path)
    _, second, *_, last = photos(copy)
    cv2.imwrite(str(second), np.zeros((768, 1024, 3), np.uint8))
    shutil.copyfile(last, last.with_stem(str(int(last.stem) + 500_000_000)))
    poses(copy, lambda rows: [*rows, [str(int(rows[-1][0]) + 500_000_000), *rows[-1][1:]]])
    done = Street(tmp_path, copy).reconstruct(capsys, tmp_path / "model", "--initialise", "plane-sweep")
    assert done["steps"] == 12 * len(done["blocks"]) and done["psnr_db"] > 5.0
    # The vehicle did not move between the two photos, so that one of them is left out.
    assert done["pictures"] == 10


def test_training_survives_wrong_poses(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = edited(walk, tmp_path, "wrong")
    poses(wrong, lambda rows: [[row[0], *other[1:]] for row, other in zip(rows, reversed(rows))])
    street = Street(tmp_path, walk, wrong)
    done = street.reconstruct(capsys, tmp_path / "model", "--initialise", "plane-sweep")
    assert done["pictures"] == 20 and done["steps"] == 12 * len(done["blocks"]) and done["psnr_db"] > 8.0
