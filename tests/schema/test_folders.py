"""What a folder is, and what may be written into it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mirror.errors import UsageError
from mirror.schema.folders import Kind, kind_of, require_own_file, require_own_folder
from tests.ingest.recordings import tree

DOCUMENTS = {
    Kind.DATASET: ("dataset.json", "mirror"),
    Kind.RECORDING: ("recording.json", "mirror-folder"),
    Kind.SUBMISSION: ("manifest.json", "mirror-submission"),
    Kind.HIDDEN: ("hidden.json", "mirror-hidden-truth"),
    Kind.MODEL: ("reconstruction.json", "mirror-reconstruction"),
    Kind.RUN: ("run.json", "mirror-run"),
    Kind.RESULTS: ("result.json", "mirror-result"),
}
SEALED = (Kind.DATASET, Kind.RECORDING, Kind.SUBMISSION, Kind.HIDDEN)


def write(folder: Path, kind: Kind) -> Path:
    name, said = DOCUMENTS[kind]
    folder.mkdir(parents=True)
    (folder / name).write_text(json.dumps({"format": said, "version": "1"}))
    return folder


@pytest.mark.parametrize("kind", DOCUMENTS)
def test_each_kind_is_known_and_refused_as_another(kind: Kind, tmp_path: Path) -> None:
    folder = write(tmp_path / "there", kind)
    assert kind_of(folder) is kind
    assert require_own_folder(folder, kind) is kind
    before = tree(tmp_path)
    for other in {*DOCUMENTS} - {kind}:
        with pytest.raises(UsageError, match=f"it is {kind.value}") as caught:
            require_own_folder(folder, other, place="--plots")
        assert caught.value.place == "--plots"
    with pytest.raises(UsageError, match=kind.value):
        require_own_folder(folder)
    assert tree(tmp_path) == before


@pytest.mark.parametrize("kind", DOCUMENTS)
def test_nothing_is_put_inside_what_is_sealed(kind: Kind, tmp_path: Path) -> None:
    inside = write(tmp_path / "there", kind) / "deeper" / "new"
    if kind not in SEALED:
        assert require_own_folder(inside, Kind.RESULTS) is None
        require_own_file(inside)
        return
    with pytest.raises(UsageError, match=f"inside {tmp_path / 'there'}, which is {kind.value}"):
        require_own_folder(inside, Kind.RESULTS)
    with pytest.raises(UsageError, match="inside"):
        require_own_file(inside)


def test_through_a_link_it_is_inside_all_the_same(tmp_path: Path) -> None:
    write(tmp_path / "there", Kind.DATASET)
    (tmp_path / "link").symlink_to(tmp_path / "there")
    with pytest.raises(UsageError, match="inside"):
        require_own_folder(tmp_path / "link" / "new", Kind.RESULTS)


@pytest.mark.parametrize(
    ("mark", "kind"),
    [
        (".rendering", Kind.SUBMISSION),
        ("work/scored.jsonl", Kind.RESULTS),
        (".made-by-mirror-demo", Kind.DEMO),
        (".lock", Kind.DATASET),
        (".staging/run.1.2/attempts/x", Kind.DATASET),
        ("traversals/street.a.1/recorded/ego_poses.parquet", Kind.DATASET),
        ("notes.txt", Kind.OTHER),
        ("one/recording.json", Kind.RECORDINGS),
    ],
)
def test_what_an_interrupted_run_left_is_its_own(mark: str, kind: Kind, tmp_path: Path) -> None:
    path = tmp_path / "there" / mark
    path.parent.mkdir(parents=True)
    path.write_text("{}")
    assert kind_of(tmp_path / "there") is kind


def test_other_files_beside_traversals_are_no_dataset(tmp_path: Path) -> None:
    (tmp_path / "there" / "traversals").mkdir(parents=True)
    assert kind_of(tmp_path / "there") is Kind.DATASET
    (tmp_path / "there" / "thesis.tex").write_text("")
    assert kind_of(tmp_path / "there") is Kind.OTHER


def test_absent_and_empty_folders_are_free_and_files_are_not(tmp_path: Path) -> None:
    assert require_own_folder(tmp_path / "none") is None
    (tmp_path / ".result.json.77.tmp").write_text("half")
    assert require_own_folder(tmp_path) is None
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="file is a file"):
        require_own_folder(tmp_path / "file", Kind.DATASET)
    with pytest.raises(UsageError, match="a folder, not a file"):
        require_own_file(tmp_path)
    require_own_file(tmp_path / "file")


def test_documents_of_others_with_the_same_name_say_nothing(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text('{"name": "a web page"}')
    assert kind_of(tmp_path) is Kind.OTHER
    assert require_own_folder(tmp_path / "new") is None
    (tmp_path / "manifest.json").write_text("{")
    assert kind_of(tmp_path) is Kind.OTHER
    (tmp_path / "recording.json").write_text("[" * 100_000)
    assert kind_of(tmp_path) is Kind.RECORDING
