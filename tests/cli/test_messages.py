"""Messages of servers that are stopped, of documents with a wrong name, and of topics files beside logs."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import BaseModel, ValidationError

from mirror.recordings.discovery import find_recordings
from mirror.schema.documents import Document, Identifier
from mirror.schema.problems import describe_problem, describe_problem_and_value
from mirror.stops import interrupted


def test_a_server_is_stopped_and_a_command_is_run_again() -> None:
    assert interrupted("mirror serve") == "mirror serve: stopped"
    assert interrupted("mirror view") == "mirror view: stopped"
    assert interrupted("mirror reconstruct").endswith("run the same command again")


def test_no_regular_expression_is_shown() -> None:
    class Named(BaseModel):
        name: Identifier

    with pytest.raises(ValidationError) as raised:
        Named(name="a b")
    said = describe_problem(raised.value.errors()[0])
    assert "letters, digits" in said and "^" not in said


def test_a_fault_of_a_document_shows_no_table() -> None:
    class Part(Document):
        every: int

    class Whole(Document):
        part: Part

    def describe(value: object) -> list[str]:
        with pytest.raises(ValidationError) as raised:
            Whole.model_validate(value)
        return [describe_problem_and_value(details) for details in raised.value.errors()]

    assert describe({"part": {"evry": 5}}) == ["this key is missing", "this key is not known (got 5)"]
    assert describe({"part": {"every": 5}, "more": {"every": 5}}) == ["this key is not known"]
    assert describe({"part": {"every": "five"}})[0].endswith("(got 'five')")


def test_the_topics_file_of_a_log_is_not_listed_as_passed_over(tmp_path: Path) -> None:
    for name in ("drive.mcap", "drive.toml", "notes.toml"):
        (tmp_path / name).touch()
    found = find_recordings([tmp_path])
    assert found.recordings == (tmp_path / "drive.mcap",)
    assert found.passed_over == (tmp_path / "notes.toml",)


def test_what_synth_writes_beside_recordings_is_not_listed_as_passed_over(tmp_path: Path) -> None:
    for name in ("drive.mcap", "rois.geojson", "maps", "notes.txt"):
        (tmp_path / name).touch()
    assert [path.name for path in find_recordings([tmp_path]).passed_over] == ["maps", "notes.txt", "rois.geojson"]
    (tmp_path / "synth.json").touch()
    assert [path.name for path in find_recordings([tmp_path]).passed_over] == ["notes.txt"]
