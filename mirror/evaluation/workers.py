"""Worker processes that score jobs; values that an earlier run logged are reused if the hash of their inputs fits."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.dataset.content_hashes import ContentHashes
from mirror.devices import CPU, hardware_name
from mirror.errors import DatasetError, MirrorError
from mirror.evaluation.scorers import load_scorer
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import Job, ScoredJob, Values
from mirror.evaluation.versions import list_versions
from mirror.pools import process_pool
from mirror.schema.finished_work import FinishedWork, hash_values
from mirror.schema.hashing import HashStyle, hash_document

_CHUNK: Final = 8
_COMMON: Final = "key of all jobs"
_START_S: Final = 1.5
"""Processor time that a worker takes to start, half a second of it for compiled kernels, and as much for OpenCV."""


@dataclass(frozen=True)
class ScoringOutcome:
    """The outcome of all jobs.

    Attributes:
        scored: scored jobs, in the order of the jobs.
        failed: problems of the other jobs, by job name.
        reused: number of jobs whose values were read from the log.
        hash: hash of everything that the values depend on.
    """

    scored: tuple[ScoredJob, ...]
    failed: dict[str, str]
    reused: int
    hash: str


@dataclass(frozen=True)
class _JobOutcome:
    name: str
    key: str
    values: Values | None
    error: str | None


class ScoreLog(FinishedWork[Values]):
    """The values of the jobs of this run and of earlier runs.

    Args:
        path: the file; it need not exist.

    Raises:
        DatasetError: a line is broken.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, dict)


def score_jobs(
    jobs: Sequence[Job],
    inputs: ScoringInputs,
    log: ScoreLog,
    *,
    workers: int,
    begins_here: bool = False,
    advance: Callable[[int], None] = lambda _: None,
) -> ScoringOutcome:
    """Score all jobs.

    Args:
        jobs: jobs to score.
        inputs: inputs of the scorer.
        log: log of this run and earlier runs.
        workers: greatest number of processes; 1: the jobs run in this process.
        begins_here: whether workers start only if the jobs that are left would take this process longer than the
            start of the workers. For jobs without networks, whose threads are those of the process.
        advance: called with the number of finished jobs.

    Raises:
        DatasetError: the truth cannot be read, or a worker process died.
    """
    found: dict[str, _JobOutcome] = {}
    rest = []
    for job in jobs:
        computed: list[str] = []

        def hash_job(job: Job = job, computed: list[str] = computed) -> str:
            computed.append(job_key(job, inputs))
            return computed[0]

        values = log.find(job.name, hash_job)
        if values is not None:
            found[job.name] = _JobOutcome(job.name, computed[0], values, None)
        else:
            rest.append(job)
    reused = len(found)
    advance(reused)
    with closing(_run(rest, inputs, workers, begins_here)) as coming:
        for done in coming:
            for one in done:
                found[one.name] = one
                if one.values is not None:
                    log.add(one.name, one.key, dict(one.values), one.values)
            advance(len(done))
    scored = tuple(ScoredJob(job, values) for job in jobs if (values := found[job.name].values) is not None)
    failed = {name: one.error for name, one in found.items() if one.error is not None}
    keys = [[job.name, found[job.name].key] for job in jobs]
    return ScoringOutcome(scored, failed, reused, hash_document(keys))


def job_key(job: Job, inputs: ScoringInputs) -> str:
    """Hash everything that affects the values of a job."""
    parts = [
        _common_key(inputs),
        [view.model_dump_json() for view in job.views],
        [inputs.layers.get(view.traversal_id, ()) for view in job.views],
        [_traversal_key(view.traversal_id, inputs) for view in job.views],
        [inputs.hashes.get(path) for path in job.reads],
        [(inputs.recorded if job.recorded else inputs.truth).image_hash(view) for view in job.views if job.truth],
        job.fingerprint,
    ]
    return hash_document(parts, HashStyle.AS_GIVEN)


def _traversal_key(traversal_id: str, inputs: ScoringInputs) -> object:
    """Hash what affects the scored masks and true images of a traversal beside its images, once in this process."""
    name = f"key of {traversal_id}"
    if name not in inputs.made:
        hashes = ContentHashes(inputs.dataset.store)
        view = inputs.dataset.where(traversal=traversal_id)
        layers = sorted({layer.rpartition(":")[2] for layer in inputs.layers.get(traversal_id, ())})
        inputs.made[name] = hash_values(hashes.view(view), hashes.traversal(traversal_id, layers))
    return inputs.made[name]


def _common_key(inputs: ScoringInputs) -> object:
    """Hash what affects the values of all jobs, once for all jobs of this process."""
    if _COMMON not in inputs.made:
        protocol = inputs.protocol
        parts: list[object] = [
            list_versions(),
            protocol.hash,
            load_scorer(protocol.task).version,
            inputs.extractor,
            sorted(inputs.unavailable),
            inputs.stand_ins,
            inputs.fitted_part is not None,
            sorted((name, str(path)) for name, path in inputs.resolver.paths.items()),
        ]
        if inputs.device != CPU:
            parts.append(hardware_name(inputs.device))
        inputs.made[_COMMON] = hash_document(parts, HashStyle.AS_GIVEN)
    return inputs.made[_COMMON]


def _run(
    jobs: Sequence[Job], inputs: ScoringInputs, workers: int, begins_here: bool
) -> Generator[list[_JobOutcome], None, None]:
    chunks = [jobs[start : start + _CHUNK] for start in range(0, len(jobs), _CHUNK)]
    if begins_here and workers > 1:
        # The first chunk includes compilation and imports, so that it says nothing about the others.
        yield from map(_score_chunk, chunks[:1], [inputs])
        chunks = chunks[1:]
        while chunks:
            begin = time.thread_time()
            yield _score_chunk(chunks[0], inputs)
            chunks = chunks[1:]
            if (time.thread_time() - begin) * len(chunks) * (workers - 1) / workers > workers * _START_S:
                break
    if workers == 1 or len(chunks) < 2:
        for chunk in chunks:
            yield _score_chunk(chunk, inputs)
        return
    waiting: set[Future[list[_JobOutcome]]] = set()
    try:
        with process_pool(workers, _start_worker, inputs) as pool:
            for chunk in chunks:
                waiting.add(pool.submit(_score_chunk_in_worker, chunk))
                if len(waiting) >= 2 * workers:
                    ready, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                    yield from (future.result() for future in ready)
            while waiting:
                ready, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in ready)
    except BrokenProcessPool as error:
        raise DatasetError(
            "a worker process died, for example because memory ran out",
            file=inputs.submission,
            remedy="run the same command again: it resumes where it stopped; --workers 1 needs the least memory",
        ) from error


_worker_inputs: list[ScoringInputs] = []


def _start_worker(inputs: ScoringInputs) -> None:
    import cv2

    cv2.setNumThreads(1)
    _worker_inputs[:] = [inputs]


def _score_chunk_in_worker(jobs: Sequence[Job]) -> list[_JobOutcome]:
    return _score_chunk(jobs, _worker_inputs[0])


def _score_chunk(jobs: Sequence[Job], inputs: ScoringInputs) -> list[_JobOutcome]:
    scorer = load_scorer(inputs.protocol.task)
    done = []
    for job in jobs:
        try:
            done.append(_JobOutcome(job.name, job_key(job, inputs), scorer.score(job, inputs), None))
        except DatasetError:
            raise
        except MirrorError as error:
            done.append(_JobOutcome(job.name, "", None, str(error)))
    return done
