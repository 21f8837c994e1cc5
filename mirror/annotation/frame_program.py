"""A program in another environment that answers one line of JSON for each frame (docs/annotation/detectors.md).

One request, one answer, in order, on the program's standard input and output; its standard error is the user's. A
program that ends, hangs or answers anything else is killed and started again, and the frame is asked once more.
"""

from __future__ import annotations

import json
import queue
import shlex
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, Final

from mirror.annotation.detections import AnnotationError
from mirror.dataset.frames import Frame
from mirror.errors import UsageError
from mirror.schema.strict_json import decode_json

_MAX_LINE: Final = 16 << 20
_POLL_S: Final = 0.1


class FrameProgram:
    """A program that answers requests about frames, started at the first frame.

    Args:
        command: words of the command.
        limit_s: seconds that one answer may take.
        format: name and version of the requests, such as ``mirror-annotate/1``.

    Attributes:
        restarts: how often the program was killed.
    """

    def __init__(self, command: list[str], limit_s: float, format: str) -> None:
        self.restarts = 0
        self._command, self._limit_s, self._format = command, limit_s, format
        self._program: _Program | None = None
        self._images = tempfile.TemporaryDirectory(prefix="mirror-annotate-")

    def ask(self, frame: Frame) -> dict[str, Any]:
        """Return the program's answer for a frame; a program that fails is restarted and asked once more.

        Raises:
            AnnotationError: there is no answer for this frame, or the program reports an error.
        """
        request = self._request(frame)
        for attempt in (1, 2):
            if self._program is None:
                self._program = _Program(self._command)
            try:
                answer = self._program.ask(request, self._limit_s)
                break
            except AnnotationError:
                self._stop()
                self.restarts += 1
                if attempt == 2:
                    raise
        if answer.get("timestamp_ns") != frame.timestamp_ns:
            raise AnnotationError(
                f"the answer is for timestamp_ns {answer.get('timestamp_ns')}",
                place="subprocess",
                expected=f"the request's, {frame.timestamp_ns}",
            )
        if "error" in answer:
            raise AnnotationError(
                f"the program reports: {answer['error']}", place="subprocess", remedy="mend the program"
            )
        return answer

    def close(self) -> None:
        """End the program and remove the images."""
        self._stop()
        self._images.cleanup()

    def _stop(self) -> None:
        if self._program is not None:
            self._program.stop()
            self._program = None

    def _request(self, frame: Frame) -> dict[str, Any]:
        images = []
        for camera, image in frame.images.items():
            suffix = "png" if image.codec != "jpeg" else "jpg"
            path = Path(self._images.name) / f"{camera}.{suffix}"
            path.write_bytes(image.read() if image.codec in ("jpeg", "png") else _png(image.decode()))
            row = image.calibration.row
            images.append(
                {
                    "camera": camera,
                    "path": str(path),
                    "timestamp_ns": image.timestamp_ns,
                    "calibration": {key: value for key, value in row.items() if _is_plain(value)},
                }
            )
        return {
            "format": self._format,
            "traversal_id": frame.traversal_id,
            "frame_index": frame.frame_index,
            "timestamp_ns": frame.timestamp_ns,
            "world_SE3_ego": {key: float(value[0]) for key, value in frame.world_SE3_ego.to_columns().items()},
            "images": images,
        }


class _Program:
    """One process, whose lines a thread reads."""

    def __init__(self, command: list[str]) -> None:
        try:
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        except OSError as error:
            raise UsageError(
                f"the program cannot be started: {error.strerror}", file=command[0], expected="a program that runs"
            ) from error
        # One line is asked for at a time: a program that writes more waits in its pipe.
        self._lines: queue.Queue[bytes | None] = queue.Queue(maxsize=1)
        self._is_stopped = threading.Event()
        threading.Thread(target=self._read, args=(self._process.stdout,), daemon=True).start()

    def _read(self, pipe: IO[bytes]) -> None:
        while line := pipe.readline(_MAX_LINE + 1):
            self._hand_over(line)
            if len(line) > _MAX_LINE or self._is_stopped.is_set():
                return
        self._hand_over(None)

    def _hand_over(self, line: bytes | None) -> None:
        while not self._is_stopped.is_set():
            try:
                self._lines.put(line, timeout=_POLL_S)
                return
            except queue.Full:
                continue

    def ask(self, request: Mapping[str, Any], limit_s: float) -> dict[str, Any]:
        """Send a request and wait for its answer."""
        pipe = self._process.stdin
        try:
            if pipe is None:
                raise BrokenPipeError
            pipe.write(json.dumps(request).encode() + b"\n")
            pipe.flush()
            line = self._lines.get(timeout=limit_s)
        except BrokenPipeError:
            line = None
        except queue.Empty as error:
            raise AnnotationError(
                f"no answer within {limit_s:g} s", place="subprocess", remedy="allow more with --set limit_s=SECONDS"
            ) from error
        if line is None:
            code = self._process.wait()
            raise AnnotationError(
                f"the program ended with {code} before it answered",
                place="subprocess",
                remedy="mend the program: what it wrote to standard error says why it ended",
            )
        if len(line) > _MAX_LINE:
            raise AnnotationError(
                f"the answer {line[:60]!r} has no end after {_MAX_LINE >> 20} MiB", place="subprocess",
                expected="one line of JSON a frame",
            )  # fmt: skip
        try:
            answer = decode_json(line)
        except ValueError as error:
            raise AnnotationError(
                f"the answer {line[:60]!r} is not JSON",
                place="subprocess",
                expected="one line of JSON a frame, and nothing else on standard output",
            ) from error
        if not isinstance(answer, dict):
            raise AnnotationError(f"the answer is {type(answer).__name__}", place="subprocess", expected="an object")
        return answer

    def stop(self) -> None:
        """Kill the process."""
        self._is_stopped.set()
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                try:
                    pipe.close()
                except BrokenPipeError:
                    continue


def _png(pixels: Any) -> bytes:
    import cv2

    return bytes(cv2.imencode(".png", pixels[..., ::-1])[1].tobytes())


def _is_plain(value: object) -> bool:
    items = value if isinstance(value, list) else [value]
    return all(item is None or isinstance(item, str | int | float) for item in items)


def program_settings(settings: Mapping[str, str]) -> tuple[list[str], float]:
    """Return the words of the setting ``command``, and the setting ``limit_s``, 60 by default.

    Raises:
        UsageError: there is no command, or the limit is not a number above 0.
    """
    words = shlex.split(settings.get("command", ""))
    if not words:
        raise UsageError("no command", place="--set", expected="command='PROGRAM ARGUMENT...'")
    try:
        limit_s = float(settings.get("limit_s", "60"))
    except ValueError:
        limit_s = 0.0
    if not 0.0 < limit_s < float("inf"):
        raise UsageError(f"limit_s={settings['limit_s']}", place="--set", expected="seconds above 0")
    return words, limit_s
