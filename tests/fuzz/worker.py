"""A process that ingests recordings one after the other, so that one that hangs can be killed from outside.

It reads one JSON request a line and answers with one JSON line: the failures, or what was written; or, for what no
recording may cause, the traceback.
"""

from __future__ import annotations

import faulthandler
import json
import selectors
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from mirror.errors import MirrorError
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.recordings.boundary import reader_errors
from mirror.recordings.registry import open_recording
from mirror.recordings.summary import summarise
from mirror.schema.documents import Roi

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Request:
    """One recording to be ingested.

    Attributes:
        path: the recording.
        reader: its format.
        roi: a scene.
        out: the dataset.
    """

    path: Path
    reader: str
    roi: Roi
    out: Path


def answer(request: Request) -> dict[str, Any]:
    """What `mirror info` and `mirror ingest` come to."""
    try:
        with reader_errors(request.path):
            summarise(open_recording(request.path, request.reader))
    except MirrorError:
        pass
    report = ingest_recordings(
        [request.path], [request.roi], request.out, IngestOptions(reader=request.reader, workers=1)
    )
    return {
        "failures": [error.to_dict() for _, error in report.failures],
        "traversals": [one.traversal_id for one in report.traversals],
        "cleaning": [drive.cleaning.model_dump() for drive in report.drives.values()],
    }


def serve() -> None:
    """Answer requests until there are no more."""
    warnings.simplefilter("ignore")
    faulthandler.enable()
    for line in sys.stdin:
        fields = json.loads(line)
        request = Request(
            Path(fields["path"]), fields["reader"], Roi.model_validate(fields["roi"]), Path(fields["out"])
        )
        try:
            with np.errstate(all="ignore"):
                found = answer(request)
        except BaseException as error:  # noqa: BLE001
            found = {"traceback": "".join(traceback.format_exception(error))}
        print(json.dumps(found), flush=True)


class Worker:
    """The process, started again where it has ended."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._said: IO[str] | None = None

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> str:
        """End it, and say what its threads were at."""
        if self._process is None or self._said is None:
            return ""
        # The fault handler writes a traceback of every thread.
        self._process.send_signal(signal.SIGABRT)
        self._process.communicate()
        self._process = None
        with self._said as file:
            file.seek(0)
            return file.read()

    def ask(self, request: Request, timeout_s: float = 20.0) -> dict[str, Any]:
        """The answer; ``{"hang": traceback}`` or ``{"died": code}`` where there is none."""
        if self._process is None:
            # A file, not a pipe: decoders of images say more than a pipe holds.
            self._said = tempfile.TemporaryFile("w+")  # noqa: SIM115
            words = [sys.executable, "-m", "tests.fuzz.worker"]
            pipe = subprocess.PIPE
            self._process = subprocess.Popen(words, cwd=ROOT, stdin=pipe, stdout=pipe, stderr=self._said, text=True)
            # Ready once it answers: its imports are no part of anybody's time.
            self._process.stdout.readline()  # type: ignore[union-attr]
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        fields = {
            "path": str(request.path),
            "reader": request.reader,
            "roi": request.roi.model_dump(),
            "out": str(request.out),
        }
        process.stdin.write(json.dumps(fields) + "\n")
        process.stdin.flush()
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            if not selector.select(timeout_s):
                return {"hang": self.stop()}
        line = process.stdout.readline()
        if not line:
            code = process.wait()
            self._process = None
            return {"died": code}
        found: dict[str, Any] = json.loads(line)
        return found


if __name__ == "__main__":
    print("ready", flush=True)
    serve()
