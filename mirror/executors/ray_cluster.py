"""Executor whose workers are actors of a Ray cluster; a node that is lost costs its items one attempt.

Without an address the cluster is of this machine and ends with the run. It listens on the loopback address and asks for
a token that this run alone knows.
"""

from __future__ import annotations

import os
import secrets
import signal
import socket
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from mirror.errors import UsageError
from mirror.executors.executor import Worker, WorkerEndedError, WorkersExecutor
from mirror.executors.job import Failure, ParallelJob
from mirror.executors.ray_worker import RayWorker
from mirror.installation import install_command
from mirror.pools import usable_cores
from mirror.version import __version__

CPU: Final = "CPU"
_NAMES: Final = {CPU: "num_cpus", "GPU": "num_gpus", "memory": "memory"}
"""Resources for which Ray has options of their own."""
PRIVATE: Final = {
    # Ray's own switch for machines whose firewall asks: all its servers listen on the loopback address.
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
    "RAY_AUTH_MODE": "token",
}
"""Environment of a cluster that others can neither reach nor use."""
_ANSWER_S: Final = 5.0
_OBJECTS_BYTES: Final = 100 << 20
_PORT: Final = 6379


class RayExecutor(WorkersExecutor[Any]):
    """Workers of a Ray cluster, whose nodes have the same version of the toolkit, and the paths that a job uses.

    Args:
        address: ``HOST:PORT`` of the cluster, ``auto`` for that of this machine, or ``ray://HOST:PORT``; None: a
            cluster of this machine for this run, or the one that this process is connected to already.
        resources: what one worker asks for, by Ray's names; CPU is 1 unless it is named.
        workers: number of workers; None: as many as the cluster has room for.

    Raises:
        UsageError: Ray is not installed, nobody answers at the address, or no node has the resources.
    """

    def __init__(self, address: str | None, resources: Mapping[str, float], workers: int | None) -> None:
        self._ray = import_ray(is_private=address is None)
        self._ends_cluster = not self._ray.is_initialized()
        self._resources = {CPU: 1.0, **resources}
        super().__init__(workers or 1)
        try:
            if self._ends_cluster:
                with _signals_kept():
                    _connect(self._ray, address, workers)
            room = _find_room(self._ray, self._resources)
        except BaseException:
            self.close()
            raise
        self.workers = workers or room

    def make_worker(self, job: ParallelJob[Any, Any]) -> _Actor:
        """Make a worker, which the cluster starts when it has room."""
        return _Actor(job, self._ray, self._ray.put(job), self._resources)

    def wait(self, connections: Sequence[Any], timeout_s: float | None) -> Sequence[Any]:
        """Return the references on which something has come."""
        ready, _ = self._ray.wait(list(connections), timeout=timeout_s)
        return list(ready)

    def close(self) -> None:
        """End all workers, and the cluster of this run."""
        super().close()
        if self._ends_cluster:
            self._ray.shutdown()


class _Actor(Worker[Any]):
    """An actor of the cluster; its connection is a reference to what it will return."""

    def __init__(self, job: ParallelJob[Any, Any], ray: ModuleType, sent: Any, resources: Mapping[str, float]) -> None:
        super().__init__(job)
        self._ray, self._sent = ray, sent
        self._options: dict[str, Any] = {_NAMES[name]: number for name, number in resources.items() if name in _NAMES}
        self._options["resources"] = {name: number for name, number in resources.items() if name not in _NAMES}
        self._actor: Any = None

    @property
    def is_running(self) -> bool:
        return self._actor is not None

    def launch(self) -> None:
        self._actor = self._ray.remote(RayWorker).options(**self._options).remote(self._sent, str(Path.cwd()))
        self.connection = self._actor.version.remote()

    def send(self, item: Any) -> None:
        self.connection = self._actor.answer.remote(item)

    def receive(self) -> Any:
        try:
            return self._ray.get(self.connection)
        except self._ray.exceptions.RayTaskError as error:
            return Failure("failed", f"its result cannot be sent: {_first_line(error.cause or error)}")
        except self._ray.exceptions.RayError as error:
            raise WorkerEndedError(f"its worker ended: {_first_line(error)}") from error

    def greet(self, word: Any) -> None:
        if word != __version__:
            raise UsageError(
                f"a node of the cluster has mirror {word}", place="--executor ray", expected=f"{__version__}, as here",
                remedy="install the same version on every node: datasets are the same bytes wherever they are made",
            )  # fmt: skip

    def end(self) -> None:
        actor, self._actor, self.connection = self._actor, None, None
        if actor is not None and self._ray.is_initialized():
            self._ray.kill(actor)


def import_ray(*, is_private: bool) -> ModuleType:
    """Import the package Ray, which reads from the environment then how its servers listen and whom they answer.

    Args:
        is_private: for a cluster of this machine that others can neither reach nor use; it does not matter where this
            process is connected to a cluster already.

    Raises:
        UsageError: it is not installed, or this process imported it for another kind of cluster.
    """
    if "ray" not in sys.modules:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        if is_private:
            os.environ.update(PRIVATE, RAY_AUTH_TOKEN=secrets.token_hex(32))
    try:
        import ray
    except ModuleNotFoundError as error:
        raise UsageError(
            "Ray is not installed", place="--executor ray", expected="the extra cluster",
            remedy=install_command("cluster"),
        ) from error  # fmt: skip
    prepared = PRIVATE.items() <= os.environ.items()
    if not ray.is_initialized() and prepared != is_private:
        raise UsageError(
            "this process imported Ray for another kind of cluster", place="--executor ray",
            expected="one kind of cluster a process: with an address, or of this machine alone",
            remedy="connect by ray.init first, or start another process",
        )  # fmt: skip
    module: ModuleType = ray
    return module


def _connect(ray: ModuleType, address: str | None, workers: int | None) -> None:
    # Ray prints on standard output that a worker ended, among what a verb prints there; the failure says it.
    vars(ray._private.worker)["_worker_logs_enabled"] = False
    if address is None:
        ray.init(
            num_cpus=workers or usable_cores(), include_dashboard=False, object_store_memory=_OBJECTS_BYTES,
            log_to_driver=False, logging_level="ERROR",
        )  # fmt: skip
        return
    _require_answer(address)
    refused = (ConnectionError, RuntimeError, ValueError, ray.exceptions.RayError)
    try:
        ray.init(address=address, log_to_driver=False, logging_level="ERROR")
    except refused as error:
        raise UsageError(
            f"the cluster refuses: {_first_line(error)}", place=f"--address {address}",
            expected="a running cluster with the same versions of Python and Ray, and its token in RAY_AUTH_TOKEN",
            remedy="`ray status --address HOST:PORT` says whether it runs; docs/scale.md begins one",
        ) from error  # fmt: skip


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Keep how this process hears signals: Ray sets its own way."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.getsignal(number) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before):
            signal.signal(number, handler)


def _require_answer(address: str) -> None:
    """Require that somebody answers at an address; Ray itself would try for minutes.

    Raises:
        UsageError: nobody does, or it is no address.
    """
    if address == "auto":
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdecimal():
        raise UsageError(
            f"{address!r}", place="--address", expected=f"HOST:PORT, ray://HOST:PORT, or auto, such as HOST:{_PORT}",
            remedy="`ray start --head` prints the address",
        )  # fmt: skip
    try:
        socket.create_connection((host, int(port)), _ANSWER_S).close()
    except (OSError, OverflowError) as error:
        raise UsageError(
            f"nobody answers: {error}", place=f"--address {address}", expected="the address of a running Ray cluster",
            remedy="`ray start --head` begins one and prints its address; without --address the work runs on a cluster "
            "of this machine",
        ) from error  # fmt: skip


def _find_room(ray: ModuleType, needed: Mapping[str, float]) -> int:
    """Return how many workers the cluster has room for.

    Raises:
        UsageError: for none.
    """
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    room = sum(int(min(node.get(name, 0.0) // number for name, number in needed.items())) for node in nodes)
    if room > 0:
        return room
    lacking = [name for name, number in needed.items() if all(node.get(name, 0.0) < number for node in nodes)]
    asked = ", ".join(f"{name}={needed[name]:g}" for name in lacking or needed)
    declared = ", ".join(f'"{name}": {needed[name]:g}' for name in (lacking or needed))
    raise UsageError(
        f"no node of the cluster has {asked}", place="--resource",
        expected=f"a node with all that a worker asks for; the cluster's {len(nodes)} nodes have "
        + ("; ".join(_describe(node) for node in nodes[:3]) or "nothing"),
        remedy=f"start a node with `ray start --address HOST:PORT --resources '{{{declared}}}'` (--num-cpus and "
        "--num-gpus for CPU and GPU), or ask for less with --resource",
    )  # fmt: skip


def _describe(node: Mapping[str, float]) -> str:
    shown = {name: number for name, number in node.items() if not name.startswith(("node:", "object_store"))}
    return ", ".join(f"{name}={number:g}" for name, number in sorted(shown.items()))


def _first_line(error: BaseException) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
