"""What cannot be done is refused at once, in the user's words, and leaves nothing behind."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

import pytest

from benchmarks.__main__ import main as benchmarks
from mirror import progress
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.ingest.rois import write_rois
from mirror.ingest.run import ingest_recordings
from mirror.synth import SynthReport
from tests.builders.folder import SCENE, write_recording


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("fleet")
    write_recording(root, "there")
    write_rois(root / "rois.geojson", [SCENE])
    assert not ingest_recordings([root / "there"], [SCENE], root / "dataset").failures
    (root / "file").write_text("no folder")
    return root


def refused(fleet: Path, capsys: pytest.CaptureFixture[str], words: str) -> str:
    """Return what a command line with folders of the fleet says when it ends with 2."""
    assert main(words.format(fleet=fleet).split()) == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        "synth --out {fleet}/none --preset tiny --workers 0",
        "rois propose {fleet}/there --workers 0",
        "ingest {fleet}/there --rois {fleet}/rois.geojson --out {fleet}/none --workers 0",
    ],
)
def test_no_workers(fleet: Path, capsys: pytest.CaptureFixture[str], words: str) -> None:
    assert "0 workers; expected at least one" in refused(fleet, capsys, words)
    assert not (fleet / "none").exists()


@pytest.mark.parametrize(
    "words",
    [
        "ingest {fleet}/there --rois {fleet}/rois.geojson --out {fleet}/file",
        "rois propose {fleet}/there --min-traversals 1 --out {fleet}/file/x.geojson",
        "stats {fleet}/dataset --plots {fleet}/file",
        "calibrate check {fleet}/dataset --out {fleet}/file",
    ],
)
def test_an_output_below_a_file(fleet: Path, capsys: pytest.CaptureFixture[str], words: str) -> None:
    if words.startswith("stats"):
        pytest.importorskip("matplotlib")
    said = refused(fleet, capsys, words)
    assert f"{fleet}/file is a file" in said
    assert "File exists" not in said


def test_a_report_makes_no_folders(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no such folder" in refused(fleet, capsys, "report {fleet}/dataset --out {fleet}/none/r.html")
    assert not (fleet / "none").exists()
    # A name without .html is the folder of a site.
    assert "nothing was written" in refused(fleet, capsys, "report {fleet}/dataset --out {fleet}")
    (fleet / "page.html").mkdir()
    assert "a folder, not a file" in refused(fleet, capsys, "report {fleet}/dataset --out {fleet}/page.html")


def test_a_report_replaces_a_report_only(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    notes = fleet / "notes.html"
    notes.write_text("<p>The ledger of refused passes")
    words = "report {fleet}/dataset --out {fleet}/"
    assert "`mirror report` did not write" in refused(fleet, capsys, f"{words}notes.html")
    assert notes.read_text() == "<p>The ledger of refused passes"
    for title in ("first", "second"):
        assert main([*f"{words}r.html".format(fleet=fleet).split(), "--title", title]) == 0
    assert "second" in (fleet / "r.html").read_text()


def test_paths_that_are_not_there(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rois", "propose", f"{fleet}/none"]) == 2
    said = capsys.readouterr()
    assert "there is no file or folder at this path" in said.err
    assert said.out == ""
    assert "1 result to compare" in refused(fleet, capsys, "compare {fleet}/none")
    assert "no such result" in refused(fleet, capsys, "compare {fleet}/none {fleet}/none")


def test_seeds_of_splits(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "seed -1" in refused(fleet, capsys, "split {fleet}/dataset s --seed -1")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("synth --out {fleet}/none --scenes 90", "mirror synth: --scenes: 90 scenes"),
        ("synth --out {fleet}/none --seed -1", "mirror synth: --seed: -1; expected a whole number"),
        ("ingest {fleet}/there --roi nan,2 --out {fleet}/none", "--roi nan,2: longitude nan; expected -180 to 180"),
        (
            "ingest {fleet}/there --roi 1,2,-5 --out {fleet}/none",
            "--roi 1,2,-5: radius_m -5; expected a number greater",
        ),
        ("rois propose {fleet}/there --min-duration-s nan", "mirror rois propose: --min-duration-s: nan; expected"),
        ("rois propose {fleet}/empty", "the folder is empty; expected a recording"),
        ("rois propose {fleet}/dataset", "a MIRROR dataset, not a recording"),
        (
            "dataset fetch {fleet}/empty --out {fleet}/none",
            "mirror dataset fetch: {fleet}/empty: not a published dataset",
        ),
    ],
)
def test_what_was_given_is_named(fleet: Path, capsys: pytest.CaptureFixture[str], words: str, message: str) -> None:
    (fleet / "empty").mkdir(exist_ok=True)
    assert message.format(fleet=fleet) in refused(fleet, capsys, words)


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


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("rois propose {fleet}/there --max-gap-s 1e400", "--max-gap-s: inf; expected a finite number"),
        ("rois propose {fleet}/there --max-gap-s 1e300", "--max-gap-s: 1e+300; expected a number less than"),
        ("rois propose {fleet}/there --min-overlap 7", "give another number with --min-overlap"),
        ("rois propose {fleet}/there --count 0", "--count: 0; expected a whole number of at least 1"),
        ("annotate track {fleet}/dataset --gate-m nan", "--gate-m: nan; expected a finite number, more than 0"),
        ("split {fleet}/dataset s --train nan", "--train: nan; expected a finite number"),
        (
            "split {fleet}/dataset s --seed 99999999999999999999",
            "--seed: 99999999999999999999; expected a whole number",
        ),
    ],
)
def test_numbers_that_nothing_can_be_computed_with(
    fleet: Path, capsys: pytest.CaptureFixture[str], words: str, named: str
) -> None:
    said = refused(fleet, capsys, words)
    assert named in said
    assert "Remedy: give another number with --" in said


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("view {fleet}/dataset {fleet}/there --host 999.1.1.1", "--host: nobody can listen at '999.1.1.1'"),
        ("view {fleet}/dataset {fleet}/there --port 70000", "--port: 70000; expected a port: 0 to 65535"),
        ("serve {fleet}/dataset --host 192.0.2.1", "--host: nobody can listen at '192.0.2.1'"),
        ("serve {fleet}/dataset --port -1", "--port: -1; expected a port: 0 to 65535"),
        ("release review {fleet}/dataset --port 70000", "--port: 70000; expected a port: 0 to 65535"),
    ],
)
def test_addresses_at_which_nobody_can_listen(
    fleet: Path, capsys: pytest.CaptureFixture[str], words: str, named: str
) -> None:
    said = refused(fleet, capsys, words)
    assert named in said
    assert "Remedy: give " in said


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


@pytest.mark.parametrize(
    "words",
    [
        "deidentify {fleet}/dataset --plate-region EU --version ../x",
        "calibrate refine {fleet}/dataset --version ../x",
    ],
)
def test_a_version_that_cannot_name_a_layer_is_refused_before_the_work(
    fleet: Path, capsys: pytest.CaptureFixture[str], words: str
) -> None:
    pytest.importorskip("scipy")
    assert "'../x' cannot name a layer" in refused(fleet, capsys, words)


def test_hidden_truth_that_no_evaluation_uses_is_not_rendered(
    fleet: Path, tiny_dataset: Dataset, tiny_recordings: SynthReport, capsys: pytest.CaptureFixture[str]
) -> None:
    recordings = tiny_recordings.recordings[0].parent
    words = f"submission hidden {tiny_dataset.root} --split novel --recordings {recordings} --out {fleet}/hidden"
    said = refused(fleet, capsys, f"{words} --protocol static-reconstruction")
    assert "uses no hidden truth" in said
    assert not (fleet / "hidden").exists()


def test_an_audit_of_nothing_is_refused(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (fleet / "nothing").mkdir()
    assert "the folder is empty" in refused(fleet, capsys, "dataset audit {fleet}/nothing --against {fleet}/dataset")
