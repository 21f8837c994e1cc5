"""The choice of an executor, which a request or a task carries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from mirror.errors import UsageError
from mirror.executors.executor import Executor, SerialExecutor
from mirror.pools import usable_cores

Kind = Literal["serial", "processes", "ray"]


@dataclass(frozen=True)
class ExecutorChoice:
    """An executor that can be opened.

    Attributes:
        kind: `serial`: in this process; `processes`: of this machine; `ray`: workers of a Ray cluster.
        workers: number of workers; None: one a core of this machine, or as many as the cluster has room for.
        address: of the cluster, as `ray.init` takes it; None: a cluster of this machine, for the run alone.
        resources: what one worker asks a cluster for, by Ray's names; CPU is 1 unless it is named.
    """

    kind: Kind = "serial"
    workers: int | None = None
    address: str | None = None
    resources: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.workers is not None and self.workers < 1:
            raise UsageError(f"{self.workers} workers", place="--workers", expected="at least one")
        if self.kind == "ray":
            return
        for given, place in ((self.address is not None, "--address"), (bool(self.resources), "--resource")):
            if given:
                raise UsageError(
                    f"the executor {self.kind} has no cluster", place=place, expected="it with --executor ray",
                    remedy=f"add --executor ray, or leave {place} out",
                )  # fmt: skip

    def open(self) -> Executor:
        """Open the executor.

        Raises:
            UsageError: Ray is not installed, nobody answers at the address, or the cluster has no such resource.
        """
        if self.kind == "serial":
            return SerialExecutor()
        if self.kind == "processes":
            from mirror.executors.processes import ProcessesExecutor

            return ProcessesExecutor(self.workers or usable_cores())
        from mirror.executors.ray_cluster import RayExecutor

        return RayExecutor(self.address, self.resources, self.workers)
