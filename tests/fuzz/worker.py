"""A process that ingests recordings one after the other; the test can kill it when a recording hangs.

It reads one JSON request per line and answers with one JSON line: the failures, or the written traversals, or the
traceback of an exception that no recording may cause.
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
    """A request to ingest one recording.

    Attributes:
        path: the recording.
        reader: name of its reader.
        roi: a scene.
        out: the dataset.
    """

    path: Path
    reader: str
    roi: Roi
    out: Path


def answer(request: Request) -> dict[str, Any]:
    """Run the work of `mirror info` and `mirror ingest`, and return the result."""
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
        "traversals": [traversal.traversal_id for traversal in report.traversals],
        "cleaning": [drive.cleaning.model_dump() for drive in report.drives.values()],
    }


def serve() -> None:
    """Answer requests until the input ends."""
    warnings.simplefilter("ignore")
    faulthandler.enable()
    for line in sys.stdin:
        fields = json.loads(line)
        request = Request(
            Path(fields["path"]), fields["reader"], Roi.model_validate(fields["roi"]), Path(fields["out"])
        )
        try:
            with np.errstate(all="ignore"):
                reply = answer(request)
        except BaseException as error:  # noqa: BLE001
            reply = {"traceback": "".join(traceback.format_exception(error))}
        print(json.dumps(reply), flush=True)


class Worker:
    """Starts the process when it is needed, again after it has ended."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._log: IO[str] | None = None

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> str:
        """End the process and return the tracebacks of its threads."""
        if self._process is None or self._log is None:
            return ""
        # The fault handler writes a traceback of every thread.
        self._process.send_signal(signal.SIGABRT)
        self._process.communicate()
        self._process = None
        with self._log as file:
            file.seek(0)
            return file.read()

    def ask(self, request: Request, timeout_s: float = 20.0) -> dict[str, Any]:
        """Return the answer; without one, ``{"hang": traceback}`` or ``{"died": code}``."""
        if self._process is None:
            # A file, not a pipe: image decoders write more messages than a pipe holds.
            self._log = tempfile.TemporaryFile("w+")  # noqa: SIM115
            words = [sys.executable, "-m", "tests.fuzz.worker"]
            pipe = subprocess.PIPE
            self._process = subprocess.Popen(words, cwd=ROOT, stdin=pipe, stdout=pipe, stderr=self._log, text=True)
            # Wait for its first line, so that no request pays for the imports.
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
        reply: dict[str, Any] = json.loads(line)
        return reply


if __name__ == "__main__":
    print("ready", flush=True)
    serve()
