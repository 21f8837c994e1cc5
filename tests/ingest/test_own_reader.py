"""Faults of a reader in a file are named so that its author finds them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.errors import ExitCode
from tests.builders.folder import LAT, LON, write_recording

READER = """
from dataclasses import replace
from mirror.recordings.readers.folder import FolderReader

class Wrapped:
    def __init__(self, inner):
        self.inner = inner
    def __getattr__(self, name):
        return getattr(self.inner, name)
    {fault}

class Own:
    name = expects = "own"
    def recognises(self, path):
        return True
    def open(self, path, options):
        return Wrapped(FolderReader().open(path, options))
"""
SOUND = "pass"
RAISES = "def track(self): return self.inner.track()['lon']"
ROTATION = "def track(self): return replace(t := self.inner.track(), rotation=t.rotation.T)"
STAMPS = """def images(self): return {
        name: replace(s, exposure_start_ns=s.exposure_start_ns * 1.0) for name, s in self.inner.images().items()}"""
COLUMN = "def calibrations(self): return self.inner.calibrations().rename_columns({'readout_ns': 'readout'})"
RIG = "rig = property(lambda self: replace(self.inner.rig, reference_camera='roof'))"


@pytest.mark.parametrize(
    ("fault", "place", "problem", "remedy"),
    [
        (RAISES, "own.py, line 10, in track", "TypeError", "if it is right, mend the reader {file}:Own"),
        (ROTATION, "track", "rotation has the shape (4, ", "mend the reader: each pose has one row"),
        (STAMPS, "column timestamp_ns", "store integers", "mend the reader: docs/schema.md"),
        (COLUMN, "column readout", "calibrations has an unknown column", "mend the reader: docs/schema.md"),
        (RIG, "Rig: the whole document", "reference camera 'roof' is not one of", "or its reader"),
    ],
)
def test_a_fault_of_a_reader_is_named(
    fault: str, place: str, problem: str, remedy: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    failure = ingest(tmp_path, fault, ExitCode.COULD_NOT_RUN, capsys)["failures"][0]
    assert failure["error"] == "RecordingError"
    assert failure["place"].endswith(place)
    assert problem in failure["problem"]
    assert remedy.format(file=tmp_path / "own.py") in failure["remedy"]
    # The named file is the recording or one of its files.
    assert Path(failure["file"]).is_relative_to(tmp_path / "fleet" / "a")


def test_the_reader_without_a_fault_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert len(ingest(tmp_path, SOUND, ExitCode.DONE, capsys)["traversals"]) == 1


def ingest(folder: Path, fault: str, code: int, capsys: pytest.CaptureFixture[str]) -> dict:
    """Ingest a recording with a reader that has a fault."""
    file = folder / "own.py"
    file.write_text(READER.format(fault=fault))
    recording = write_recording(folder / "fleet", "a")
    words = ["ingest", str(recording), "--reader", f"{file}:Own", "--roi", f"{LON},{LAT},60,street"]
    assert main([*words, "--out", str(folder / "dataset"), "--json"]) == code
    return json.loads(capsys.readouterr().out)
