"""Refusals that need more than a command line; `test_wrong_inputs` has the table of the others."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

import pytest

from benchmarks.__main__ import main as benchmarks
from mirror import progress
from mirror.cli.main import main
from mirror.ingest.rois import write_rois
from mirror.ingest.run import ingest_recordings
from tests.builders.folder import SCENE, write_recording


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("fleet")
    write_recording(root, "there")
    write_rois(root / "rois.geojson", [SCENE])
    assert not ingest_recordings([root / "there"], [SCENE], root / "dataset").failures
    return root


def refused(fleet: Path, capsys: pytest.CaptureFixture[str], words: str) -> str:
    """Return what a command line with folders of the fleet says when it ends with 2."""
    assert main(words.format(fleet=fleet).split()) == 2
    return capsys.readouterr().err


def test_a_report_replaces_a_report(fleet: Path) -> None:
    for title in ("first", "second"):
        assert main(["report", f"{fleet}/dataset", "--out", f"{fleet}/r.html", "--title", title]) == 0
    assert "second" in (fleet / "r.html").read_text()


def test_index_notices_a_table_that_was_cut(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (table,) = (fleet / "dataset").glob("traversals/*/recorded/ego_poses.parquet")
    data = table.read_bytes()
    table.unlink()
    table.write_bytes(data[:-100])
    said = refused(fleet, capsys, "index {fleet}/dataset")
    assert f"has {len(data) - 100:,} bytes" in said
    assert "drive there" in said
    table.unlink()
    assert "missing" in refused(fleet, capsys, "index {fleet}/dataset")
    table.write_bytes(data)
    assert main(["index", f"{fleet}/dataset"]) == 0


def test_help_of_benchmarks(capsys: pytest.CaptureFixture[str]) -> None:
    assert benchmarks(["--help"]) == 0
    assert "usage: python -m benchmarks NAME" in capsys.readouterr().out
    assert benchmarks(["nothing"]) == 2
    assert "no benchmark is called 'nothing'" in capsys.readouterr().err


def test_long_work_in_a_log_says_how_far_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "BETWEEN_LINES_S", 0.0)
    with progress.progress_bar(quiet=False) as bar:
        bar.start("images", 2000)
        bar.advance(1500)
    assert "images: 1,500 of 2,000" in capsys.readouterr().err
    with progress.progress_bar(quiet=True) as bar:
        bar.start("images", 2)
        bar.advance(1)
    assert capsys.readouterr().err == ""
    assert not sys.stderr.isatty()


def test_a_driver_that_does_not_answer_is_found_before_the_street_is_opened(
    fleet: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))  # Bound and not listening: every connection is refused.
        address = f"127.0.0.1:{unused.getsockname()[1]}"
        words = f"simulate {{fleet}}/none --scenario free-traffic --policy grpc://{address} --out {{fleet}}/run"
        said = refused(fleet, capsys, words)
    assert f"--policy: {address} does not answer" in said
    assert "Remedy: start it first" in said
    assert not (fleet / "run").exists()
