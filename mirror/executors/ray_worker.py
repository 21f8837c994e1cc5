"""The part of the Ray executor that runs in a worker of the cluster; it imports nothing that is heavy."""

from __future__ import annotations

import os
from contextlib import suppress
from typing import Any

from mirror.executors.job import Failure, JobFunction, ParallelJob
from mirror.pools import ONE_THREAD
from mirror.version import __version__


class RayWorker:
    """An actor that does a job on one item at a time.

    Args:
        job: the work.
        current: current folder of the driver, from which options name files. A node need not have it.
    """

    def __init__(self, job: ParallelJob[Any, Any], current: str) -> None:
        with suppress(OSError):
            os.chdir(current)
        os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
        self._function = JobFunction(job)

    def version(self) -> str:
        """Return the version of the toolkit on this node."""
        return __version__

    def answer(self, item: Any) -> Any | Failure:
        """Return the result of an item, or its failure."""
        return self._function.answer(item)
