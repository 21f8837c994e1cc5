"""No command writes into another kind of folder: it names the kind, and leaves the folder unchanged."""

from __future__ import annotations

import importlib.util
import json
import shutil
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from tests.builders.folder import tree
from tests.evaluation.submissions import small, small_text, write_renders
from tests.interruption import interrupt_before

FOLDERS = {
    "evaluate": "evaluate {data} {here}/submission --protocol {here}/small.toml --out {out}",
    "evaluate with features": "evaluate {data} {here}/submission --protocol {here}/small.toml --out {here}/new"
    " --features {out}",
    "submission new": "submission new {data} --protocol {here}/small.toml --split novel --out {out}",
    "submission hidden": "submission hidden {data} --split novel --recordings {here}/tiny --out {out}",
    "baseline": "baseline {data} --method nearest_frame --split novel --protocol {here}/small.toml --out {out}",
    "render": "render {data} {here}/model --split novel --out {out}",
    "render along a trajectory": "render {data} {here}/model --trajectory lane-shift:2 --out {out}",
    "reconstruct": "reconstruct {data} --split novel --steps 1 --out {out}",
    "synth": "synth --preset tiny --out {out}",
    "demo": "demo --quick --out {out}",
    "stats": "stats {data} --plots {out}",
    "leaderboard build": "leaderboard build --out {out}",
    "leaderboard add": "leaderboard add {here}/result.json {data} --dataset-name street --board {out}",
}
FILES = {
    "report": "report {data} --out {out}/page.html",
    "export-ply": "export-ply {data} {here}/model --out {out}/model.ply",
    "render a video": "render {data} {here}/model --trajectory lane-shift:2 --out {out}/video.mp4",
}
NEEDS = {"stats": "matplotlib", "reconstruct": "torch"}


@pytest.fixture(scope="module")
def here(dataset: Dataset, root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("outputs")
    write_renders(dataset, small(), here / "submission")
    (here / "small.toml").write_text(small_text())
    (here / "result.json").write_text("{}")
    (here / "other").mkdir()
    (here / "other" / "letter.txt").write_text("mine")
    for name in ("dataset", "tiny"):
        shutil.copytree(root.parent / name, here / name)
    return here


def refused(words: str, capsys: pytest.CaptureFixture[str], **places: Path) -> str:
    code = main([word.format(**places) for word in words.split()])
    said = capsys.readouterr()
    assert code == 2, said
    return said.err


@pytest.mark.parametrize("verb", FOLDERS)
def test_other_kind_of_folder_is_refused(verb: str, here: Path, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if verb in NEEDS and importlib.util.find_spec(NEEDS[verb]) is None:
        pytest.skip(f"needs {NEEDS[verb]}")
    before = tree(here)
    for out, kind in (("dataset", "a dataset"), ("submission", "a submission"), ("other", "letter.txt")):
        # A folder with other files may get caches; for a submission, `render` asks the model whether it started it.
        if (verb, out) == ("evaluate with features", "other") or (verb.startswith("render") and out == "submission"):
            continue
        said = refused(FOLDERS[verb], capsys, data=root, here=here, out=here / out)
        words = ("a folder with other files", kind) if out == "other" else (kind, "not an empty folder")
        assert str(here / out) in said and any(word in said for word in words), said
        assert "Remedy" in said
    inside = refused(FOLDERS[verb], capsys, data=root, here=here, out=here / "dataset" / "new" / "deep")
    assert f"inside {here / 'dataset'}, which is a dataset" in inside
    assert tree(here) == before
    assert not (here / "dataset" / "new").exists()


@pytest.mark.parametrize("verb", FILES)
def test_file_in_other_kind_of_folder(verb: str, here: Path, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = tree(here)
    for inside in ("dataset", "submission", "tiny/guangzhou-urban-01"):
        assert f"inside {here / inside}, which is" in refused(
            FILES[verb], capsys, data=root, here=here, out=here / inside
        )
    assert tree(here) == before


def test_plots_and_sites_are_replaced(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    for words in (["stats", str(root), "--plots"], ["leaderboard", "build", "--out"]):
        out = tmp_path / words[0]
        assert main([*words, str(out)]) == main([*words, str(out)]) == 0
        shutil.move(
            out / "index.html" if words[0] == "leaderboard" else out / "speed.png", tmp_path / words[0] / "b.txt"
        )
    capsys.readouterr()
    assert main(["stats", str(root), "--plots", str(tmp_path / "stats")]) == 2
    assert "it holds b.txt, which is not a plot of this command" in capsys.readouterr().err


def test_interrupted_commands_continue(
    dataset: Dataset, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "small.toml").write_text(small_text())
    lines = 'task = "reconstruction"', 'name = "novel"\nroles = ["held_out"]'
    moved = small_text(every=10, metrics='[[metrics]]\nmetric = "psnr"\n').replace(
        lines[1], lines[1] + "\nego_shift_m = 1.0"
    )
    (tmp_path / "moved.toml").write_text(moved)
    asked = ["--split", "novel", "--protocol"]
    recordings = ["--recordings", str(root.parent / "tiny")]
    for words in (
        ["submission", "new", str(root), *asked, str(tmp_path / "small.toml")],
        ["baseline", str(root), "--method", "nearest_frame", *asked, str(tmp_path / "small.toml")],
        ["submission", "hidden", str(root), *recordings, *asked, str(tmp_path / "moved.toml")],
    ):
        assert main([*words, "--out", str(tmp_path / "whole")]) == 0
        with interrupt_before("*.png", 4):
            assert main([*words, "--out", str(tmp_path / "stopped")]) == 130
        half = tree(tmp_path / "stopped")
        assert main([*words, "--out", str(tmp_path / "stopped")]) == 0
        whole, stopped = tree(tmp_path / "whole"), tree(tmp_path / "stopped")
        if words[0] == "baseline":
            # The manifest states the number of images per second.
            for made in (whole, stopped):
                del made["manifest.json"]
            assert json.loads((tmp_path / "stopped" / "manifest.json").read_text())["method"]["name"] == "nearest_frame"
        assert stopped == whole
        assert {name for name in half if name.endswith(".png")} <= set(whole)
        for name in ("whole", "stopped"):
            shutil.rmtree(tmp_path / name)
    capsys.readouterr()
