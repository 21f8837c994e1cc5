"""Scores jobs in processes of their own; what an earlier run scored is taken from its log, by hash of what is read."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mirror.errors import DatasetError, MirrorError
from mirror.evaluation.scorers import load_scorer
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import Job, ScoredJob, Values
from mirror.pools import process_pool
from mirror.schema.files import unwritable_error
from mirror.version import __version__

_CHUNK: Final = 8


@dataclass(frozen=True)
class ScoringOutcome:
    """What came of all jobs.

    Attributes:
        scored: jobs that were scored, in their order.
        failed: why the others were not, by name.
        reused: how many were taken from the log.
    """

    scored: tuple[ScoredJob, ...]
    failed: dict[str, str]
    reused: int


@dataclass(frozen=True)
class _Done:
    name: str
    key: str
    values: Values | None
    error: str | None
    reused: bool


class ScoreLog:
    """What was scored, one line a job, in a file that only grows: an interrupted run goes on where it stopped.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.known: dict[str, tuple[str, dict[str, Any]]] = {}
        if path.is_file():
            for line in path.read_bytes().splitlines():
                try:
                    row = json.loads(line)
                    self.known[row["name"]] = (row["key"], row["values"])
                except (ValueError, KeyError, TypeError):
                    # The line that an interruption cut.
                    continue

    def add(self, name: str, key: str, values: Values) -> None:
        """Append a line.

        Raises:
            DatasetError: the file cannot be written.
        """
        line = json.dumps({"name": name, "key": key, "values": dict(values)}) + "\n"
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("ab") as file:
                # Begun anew if the last line was cut.
                file.write(line.encode() if _ends_whole(self._path) else b"\n" + line.encode())
        except OSError as error:
            raise unwritable_error(self._path, error) from error


def score_jobs(
    jobs: Sequence[Job],
    inputs: ScoringInputs,
    log: ScoreLog,
    *,
    workers: int,
    advance: Callable[[int], None] = lambda _: None,
) -> ScoringOutcome:
    """Score all jobs.

    Args:
        jobs: what to do.
        inputs: what they read.
        log: of this and earlier runs.
        workers: processes; 1: this one.
        advance: told of each job that is done.

    Raises:
        DatasetError: the truth cannot be read, or a worker process died.
    """
    found: dict[str, _Done] = {}
    with closing(_run(jobs, inputs, log, workers)) as coming:
        for done in coming:
            for one in done:
                found[one.name] = one
                if one.values is not None and not one.reused:
                    log.add(one.name, one.key, one.values)
            advance(len(done))
    scored = tuple(ScoredJob(job, values) for job in jobs if (values := found[job.name].values) is not None)
    failed = {name: one.error for name, one in found.items() if one.error is not None}
    return ScoringOutcome(scored, failed, sum(one.reused for one in found.values()))


def job_key(job: Job, inputs: ScoringInputs) -> str:
    """A hash of everything that decides what a job finds."""
    protocol = inputs.protocol
    parts = [
        __version__,
        protocol.hash,
        load_scorer(protocol.task).version,
        inputs.extractor,
        sorted(inputs.unavailable),
        inputs.stand_ins,
        [part.model_dump() for part in inputs.manifest.appearance.held_out_pixels],
        sorted((name, str(path)) for name, path in inputs.resolver.paths.items()),
        [view.model_dump(mode="json") for view in job.views],
        [inputs.layers.get(view.traversal_id, ()) for view in job.views],
        [inputs.fingerprint(path) for path in job.reads],
        [inputs.truth.image_hash(view) for view in job.views] if job.truth else [],
    ]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _run(jobs: Sequence[Job], inputs: ScoringInputs, log: ScoreLog, workers: int) -> Generator[list[_Done], None, None]:
    chunks = [jobs[start : start + _CHUNK] for start in range(0, len(jobs), _CHUNK)]
    asked = [(chunk, {job.name: log.known[job.name] for job in chunk if job.name in log.known}) for chunk in chunks]
    if workers == 1 or len(chunks) < 2:
        for chunk, known in asked:
            yield _do(chunk, known, inputs)
        return
    waiting: set[Future[list[_Done]]] = set()
    try:
        with process_pool(workers, _begin, inputs) as pool:
            for chunk, known in asked:
                waiting.add(pool.submit(_do_here, chunk, known))
                if len(waiting) >= 2 * workers:
                    ready, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                    yield from (future.result() for future in ready)
            while waiting:
                ready, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in ready)
    except BrokenProcessPool as error:
        raise DatasetError(
            "a worker process died, as it does when memory runs out",
            file=inputs.submission,
            remedy="run the same command again: it goes on where it stopped; --workers 1 needs least memory",
        ) from error


_inputs: list[ScoringInputs] = []


def _begin(inputs: ScoringInputs) -> None:
    import cv2

    cv2.setNumThreads(1)
    _inputs[:] = [inputs]


def _do_here(jobs: Sequence[Job], known: Mapping[str, tuple[str, dict[str, Any]]]) -> list[_Done]:
    return _do(jobs, known, _inputs[0])


def _do(jobs: Sequence[Job], known: Mapping[str, tuple[str, dict[str, Any]]], inputs: ScoringInputs) -> list[_Done]:
    scorer = load_scorer(inputs.protocol.task)
    done = []
    for job in jobs:
        try:
            key = job_key(job, inputs)
            if job.name in known and known[job.name][0] == key:
                done.append(_Done(job.name, key, known[job.name][1], None, reused=True))
            else:
                done.append(_Done(job.name, key, scorer.score(job, inputs), None, reused=False))
        except DatasetError:
            raise
        except MirrorError as error:
            done.append(_Done(job.name, "", None, str(error), reused=False))
    return done


def _ends_whole(path: Path) -> bool:
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        if not size:
            return True
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"
