"""Runs jobs side by side, each in a process of one thread; what is done is not done again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Final

from benchmarks.studies.static_reconstruction.job import OUTCOMES, Job, read_outcome

_JOB: Final = "benchmarks.studies.static_reconstruction.job"
_ONE_THREAD: Final = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "passive",
}


def is_done(job: Job, folder: Path) -> bool:
    """Whether a job's outcome is there, see `read_outcome`."""
    return read_outcome(folder / OUTCOMES / f"{job.name}.json") is not None


def run_all(jobs: Sequence[Job], folder: Path, side_by_side: int) -> int:
    """Run jobs in their order, so many at once; the number of those that failed, whose logs are named."""
    waiting = [job for job in jobs if not is_done(job, folder)]
    minutes = sum(job.core_minutes for job in waiting) / side_by_side
    print(f"{len(jobs) - len(waiting)} of {len(jobs)} jobs are done; at least {minutes:.0f} minutes to go", flush=True)
    begin = time.monotonic()

    def one(job: Job) -> bool:
        log = folder / "logs" / f"{job.name}.txt"
        log.parent.mkdir(parents=True, exist_ok=True)
        words = [
            sys.executable,
            "-m",
            "benchmarks.studies.static_reconstruction.job",
            str(folder),
            json.dumps(asdict(job)),
        ]
        with log.open("w") as out:
            code = subprocess.run(words, env={**os.environ, **_ONE_THREAD}, stdout=out, stderr=out, check=False)
        since = (time.monotonic() - begin) / 60.0
        print(f"{since:6.1f} min  {job.name}  {'done' if not code.returncode else f'FAILED, see {log}'}", flush=True)
        return code.returncode == 0

    with ThreadPoolExecutor(side_by_side) as pool:
        return sum(not passed for passed in pool.map(one, waiting))
