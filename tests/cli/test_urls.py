"""URLs on the command line: read where a verb can, refused in words where it cannot."""

from __future__ import annotations

from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.command_line import local_path

OUTPUTS = {
    "ingest": "ingest there --roi 1,2 --out {url}",
    "ingest with a recording": "ingest {url} --roi 1,2 --out out",
    "ingest with ROIs": "ingest there --rois {url} --out out",
    "rois propose": "rois propose there --out {url}",
    "rois propose with a recording": "rois propose {url}",
    "synth": "synth --out {url} --preset tiny",
    "demo": "demo --out {url}",
    "split": "split {url} name",
    "sql": "sql there select --out {url}/x.csv",
    "stats": "stats there --plots {url}",
    "report": "report there --out {url}",
    "submission new": "submission new there --protocol p --split s --out {url}",
    "submission check": "submission check there {url}",
    "submission hidden": "submission hidden there --split s --recordings there --out {url}",
    "submission hidden of recordings": "submission hidden there --split s --recordings {url} --out out",
    "evaluate": "evaluate there there --out {url}",
    "evaluate with a submission": "evaluate there {url}",
    "evaluate with hidden truth": "evaluate there there --hidden {url}",
    "reconstruct": "reconstruct there --split s --out {url}",
    "render": "render there there --split s --out {url}",
    "render with a model": "render there {url} --split s --out out",
    "export": "export colmap there --out {url}",
    "export-ply": "export-ply there there --out {url}/x.ply",
    "export-ply with a model": "export-ply there {url} --out x.ply",
    "plot": "plot there --out {url}",
    "view": "view there --save {url}/x.rrd",
    "view with a model": "view there {url}",
    "compare": "compare {url} there",
    "baseline": "baseline there --method mean_color --split s --out {url}",
    "depth": "depth there --split s --weights {url}",
    "dataset publish": "dataset publish {url} --split s --out out",
    "dataset fetch": "dataset fetch there --out {url}",
    "deidentify": "deidentify {url} --plate-region CN",
    "release check": "release check {url}",
    "release build": "release build {url} --name n --licence l --contact c --out out",
    "release build to": "release build there --name n --licence l --contact c --out {url}",
    "release build with a vault": "release build there --name n --licence l --contact c --vault {url} --out out",
    "release withdraw": "release withdraw there t.d.1 --out {url}",
    "calibrate check": "calibrate check there --out {url}",
    "calibrate refine": "calibrate refine {url}",
    "annotate": "annotate {url} --annotator file",
    "annotate track": "annotate track {url} --boxes a@1",
    "annotate export": "annotate export there --boxes a@1 --out {url}",
    "generate train": "generate train {url} --steps 1 --out out",
    "generate train to": "generate train there --steps 1 --out {url}",
    "leaderboard build": "leaderboard build --out {url}",
    "leaderboard build with a board": "leaderboard build --also {url}",
    "leaderboard add": "leaderboard add {url} d --dataset-name d",
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
    assert "Remedy: install the package with which fsspec reads foo://, or correct the URL" in error


def test_a_url_without_a_dataset(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "memory://nothing"]) == 2
    assert "memory://nothing" in capsys.readouterr().err
