"""Kinds of folders, and the outputs that they accept."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mirror.errors import UsageError
from mirror.schema.folders import FolderKind, find_kind, require_output_file, require_output_folder
from tests.builders.folder import tree

DOCUMENTS = {
    FolderKind.DATASET: ("dataset.json", "mirror"),
    FolderKind.RECORDING: ("recording.json", "mirror-folder"),
    FolderKind.SUBMISSION: ("manifest.json", "mirror-submission"),
    FolderKind.GENERATED: ("generated.json", "mirror-generated"),
    FolderKind.HIDDEN: ("hidden.json", "mirror-hidden-truth"),
    FolderKind.MODEL: ("reconstruction.json", "mirror-reconstruction"),
    FolderKind.RUN: ("run.json", "mirror-run"),
    FolderKind.RESULTS: ("result.json", "mirror-result"),
}
SEALED = (FolderKind.DATASET, FolderKind.RECORDING, FolderKind.SUBMISSION, FolderKind.HIDDEN)


def write(folder: Path, kind: FolderKind) -> Path:
    name, said = DOCUMENTS[kind]
    folder.mkdir(parents=True)
    (folder / name).write_text(json.dumps({"format": said, "version": "1"}))
    return folder


@pytest.mark.parametrize("kind", DOCUMENTS)
def test_each_kind_is_recognised_and_refused_as_another(kind: FolderKind, tmp_path: Path) -> None:
    folder = write(tmp_path / "there", kind)
    assert find_kind(folder) is kind
    assert require_output_folder(folder, kind) is kind
    before = tree(tmp_path)
    for other in {*DOCUMENTS} - {kind}:
        with pytest.raises(UsageError, match=f"it is {kind.value}") as caught:
            require_output_folder(folder, other, place="--plots")
        assert caught.value.place == "--plots"
    with pytest.raises(UsageError, match=kind.value):
        require_output_folder(folder)
    assert tree(tmp_path) == before


@pytest.mark.parametrize("kind", DOCUMENTS)
def test_no_output_is_written_inside_a_sealed_folder(kind: FolderKind, tmp_path: Path) -> None:
    inside = write(tmp_path / "there", kind) / "deeper" / "new"
    if kind not in SEALED:
        assert require_output_folder(inside, FolderKind.RESULTS) is None
        require_output_file(inside)
        return
    with pytest.raises(UsageError, match=f"inside {tmp_path / 'there'}, which is {kind.value}"):
        require_output_folder(inside, FolderKind.RESULTS)
    with pytest.raises(UsageError, match="inside"):
        require_output_file(inside)


def test_linked_path_inside_a_sealed_folder_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "there", FolderKind.DATASET)
    (tmp_path / "link").symlink_to(tmp_path / "there")
    with pytest.raises(UsageError, match="inside"):
        require_output_folder(tmp_path / "link" / "new", FolderKind.RESULTS)


@pytest.mark.parametrize(
    ("mark", "kind"),
    [
        (".rendering", FolderKind.SUBMISSION),
        (".generating", FolderKind.GENERATED),
        ("work/scored.jsonl", FolderKind.RESULTS),
        (".made-by-mirror-demo", FolderKind.DEMO),
        (".lock", FolderKind.DATASET),
        (".staging/run.1.2/attempts/x", FolderKind.DATASET),
        ("traversals/street.a.1/recorded/ego_poses.parquet", FolderKind.DATASET),
        ("notes.txt", FolderKind.OTHER),
        ("one/recording.json", FolderKind.RECORDINGS),
    ],
)
def test_interrupted_run_may_resume_in_its_folder(mark: str, kind: FolderKind, tmp_path: Path) -> None:
    path = tmp_path / "there" / mark
    path.parent.mkdir(parents=True)
    path.write_text("{}")
    assert find_kind(tmp_path / "there") is kind


def test_folder_with_other_files_is_not_a_dataset(tmp_path: Path) -> None:
    (tmp_path / "there" / "traversals").mkdir(parents=True)
    assert find_kind(tmp_path / "there") is FolderKind.DATASET
    (tmp_path / "there" / "thesis.tex").write_text("")
    assert find_kind(tmp_path / "there") is FolderKind.OTHER


def test_absent_and_empty_folders_are_accepted_and_files_refused(tmp_path: Path) -> None:
    assert require_output_folder(tmp_path / "none") is None
    (tmp_path / ".result.json.77.tmp").write_text("half")
    assert require_output_folder(tmp_path) is None
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="file is a file"):
        require_output_folder(tmp_path / "file", FolderKind.DATASET)
    with pytest.raises(UsageError, match="a folder, not a file"):
        require_output_file(tmp_path)
    require_output_file(tmp_path / "file")


def test_documents_of_other_programs_do_not_identify_a_folder(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text('{"name": "a web page"}')
    assert find_kind(tmp_path) is FolderKind.OTHER
    assert require_output_folder(tmp_path / "new") is None
    (tmp_path / "manifest.json").write_text("{")
    assert find_kind(tmp_path) is FolderKind.OTHER
    (tmp_path / "recording.json").write_text("[" * 100_000)
    assert find_kind(tmp_path) is FolderKind.RECORDING
