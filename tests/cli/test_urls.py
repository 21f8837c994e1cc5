"""URLs on the command line: read where a verb can, refused in words where it cannot."""

from __future__ import annotations

from pathlib import Path

import pytest

from leaderboard.command import main as leaderboard
from mirror.cli.main import main
from mirror.cli.method import method_main
from mirror.command_line import local_path
from mirror_baselines.mean_color import APPEARANCE, METHOD, render

OUTPUTS = {
    "ingest": "ingest there --roi 1,2 --out {url}",
    "ingest with a recording": "ingest {url} --roi 1,2 --out out",
    "ingest with ROIs": "ingest there --rois {url} --out out",
    "rois propose": "rois propose there --out {url}",
    "rois propose with a recording": "rois propose {url}",
    "synth": "synth --out {url} --preset tiny",
    "demo": "demo --out {url}",
    "split": "split {url} name",
    "stats": "stats there --plots {url}",
    "report": "report there --out {url}",
    "submission new": "submission new there --protocol p --split s --out {url}",
    "submission check": "submission check {url} --truth there",
    "submission hidden": "submission hidden there --split s --preset tiny --out {url}",
    "evaluate": "evaluate there --truth there --out {url}",
    "evaluate with a submission": "evaluate {url} --truth there",
    "evaluate with hidden truth": "evaluate there --truth there --hidden {url}",
    "reconstruct": "reconstruct there --split s --out {url}",
    "render": "render there --dataset there --split s --out {url}",
    "render with a model": "render {url} --dataset there --split s --out out",
    "bake": "bake there --dataset there --out {url}/x.ply",
    "bake with a model": "bake {url} --dataset there --out x.ply",
    "compare": "compare {url} there",
}


@pytest.mark.parametrize("words", OUTPUTS.values(), ids=OUTPUTS)
@pytest.mark.parametrize("url", ["s3://bucket/deep", "zip::there.zip"])
def test_no_verb_takes_a_url_for_a_path(
    words: str, url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words.format(url=url).split()) == 2
    error = capsys.readouterr().err
    assert url in error
    assert "a path, not a URL" in error
    assert list(tmp_path.iterdir()) == []


def test_baselines_and_the_board_take_no_url_for_a_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert method_main(["there", "--split", "s", "--out", "s3://bucket/x"], render, METHOD, APPEARANCE) == 2
    for words in ("build --out s3://bucket/x", "build --also s3://bucket/x", "add s3://bucket/x --dataset d"):
        assert leaderboard(words.split()) == 2
    assert capsys.readouterr().err.count("a path, not a URL") == 4
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("path", ["c:/data", "a:b/c", "12:30/x"])
def test_what_is_no_url_is_a_path(path: str) -> None:
    assert local_path(Path(path)) == Path(path)


@pytest.mark.parametrize("verb", ["check", "info", "index"])
def test_verbs_that_take_a_folder_say_so(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([verb, "memory://x"]) == 2
    error = capsys.readouterr().err
    assert "memory://x: this verb takes a path, not a URL" in error


@pytest.mark.parametrize("verb", ["stats", "report"])
def test_an_unknown_protocol_is_named(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([verb, "foo://x"]) == 2
    error = capsys.readouterr().err
    assert "foo://x: this URL cannot be opened" in error
    assert "Remedy: pip install" in error


def test_a_url_without_a_dataset(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "memory://nothing"]) == 2
    assert "memory://nothing" in capsys.readouterr().err
