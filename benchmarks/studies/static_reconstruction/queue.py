"""Run jobs side by side, each in a process with one thread; jobs with a current outcome are not run again."""

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

from benchmarks.studies.static_reconstruction.jobs import Job
from benchmarks.studies.static_reconstruction.records import is_done

_MODULE: Final = "benchmarks.studies.static_reconstruction.run_job"
_ONE_THREAD: Final = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "passive",
}


def run_all(jobs: Sequence[Job], folder: Path, side_by_side: int) -> int:
    """Run jobs in their order.

    Args:
        jobs: to run.
        folder: working folder of the study.
        side_by_side: how many jobs run at the same time.

    Returns:
        The number of jobs that failed; their logs are printed by name.
    """
    waiting = [job for job in jobs if not is_done(job, folder)]
    minutes = sum(job.core_minutes for job in waiting) / side_by_side
    print(f"{len(jobs) - len(waiting)} of {len(jobs)} jobs are done; at least {minutes:.0f} minutes to go", flush=True)
    begin = time.monotonic()

    def run_one(job: Job) -> bool:
        log = folder / "logs" / f"{job.name}.txt"
        log.parent.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", _MODULE, str(folder), json.dumps(asdict(job))]
        with log.open("w") as out:
            done = subprocess.run(command, env={**os.environ, **_ONE_THREAD}, stdout=out, stderr=out, check=False)
        since = (time.monotonic() - begin) / 60.0
        print(f"{since:6.1f} min  {job.name}  {'done' if not done.returncode else f'FAILED, see {log}'}", flush=True)
        return done.returncode == 0

    with ThreadPoolExecutor(side_by_side) as pool:
        return sum(not passed for passed in pool.map(run_one, waiting))
