"""Drives the suite of a protocol: in parallel, resumable, with the same bytes for any number of workers."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

from hybridworldsim.simulator.policy_registry import make_policy
from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.renderers.registry import RendererFactory
from hybridworldsim.simulator.rollout.run import RolloutRequest, RolloutResult, run_rollout
from hybridworldsim.simulator.street.opening import open_street
from mirror.errors import DatasetError, UsageError
from mirror.pools import process_pool
from mirror.progress import ProgressReporter
from mirror.protocols.document import Protocol
from mirror.protocols.suite import Suite, SuiteDrive, list_drives
from mirror.schema.documents import Document
from mirror.schema.files import read_json, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.rollout import ROLLOUT, read_rollout

SUITE_FILE: Final = "suite.json"
_ROUNDS: Final = 3
"""Number of times that a drive is begun if the machine fails each time."""
_PREFLIGHT_S: Final = 1.0


class SuiteRun(Document):
    """``suite.json``: what the rollouts of a folder were asked for.

    Attributes:
        format: always ``mirror-suite``.
        version: version of this document's format.
        protocol: name of the protocol.
        protocol_hash: its hash.
        policy: name of the policy.
    """

    format: Literal["mirror-suite"] = "mirror-suite"
    version: Literal["1.0"] = "1.0"
    protocol: str
    protocol_hash: str
    policy: str


@dataclass(frozen=True)
class SuiteOutcome:
    """Outcome of the drives of a suite.

    Attributes:
        drives: number of drives of the suite.
        reused: drives that were complete before.
        endings: number of drives by ending.
        policy_errors: errors of the policy, by folder of the drive.
        machine_errors: why drives have no rollout, by folder: the machine failed each time. They are not scored.
    """

    drives: int
    reused: int
    endings: dict[str, int]
    policy_errors: dict[str, str]
    machine_errors: dict[str, str]


def require_suite(protocol: Protocol) -> Suite:
    """Return the suite of a protocol.

    Raises:
        UsageError: it has none.
    """
    if protocol.suite is None:
        raise UsageError(
            f"protocol {protocol.name} has no suite of drives", place="--suite",
            expected="a protocol with a table [suite], such as closed-loop-mini",
        )  # fmt: skip
    return protocol.suite


def drive_suite(
    protocol: Protocol, policy: str, out: Path, *, workers: int, reporter: ProgressReporter
) -> SuiteOutcome:
    """Drive what is missing of a suite, after a preflight of one second.

    Each drive has a policy of its own. A drive whose machine fails (its process ends, memory or the disk is full) is
    begun again, from the second time on alone in a process.

    Args:
        protocol: a protocol with a suite.
        policy: name of an installed policy, or ``FILE.py:CLASS``.
        out: folder of the rollouts: new, empty, or that of the same suite and policy.
        workers: number of worker processes.
        reporter: receives the progress.

    Raises:
        UsageError: the folder is another one's, the protocol has no suite, the policy asks for a camera that the suite
            lacks or fails in the preflight, or a scenario does not fit on its street.
        DatasetError: the folder cannot be written.
    """
    suite = require_suite(protocol)
    drives = list_drives(suite)
    _open_folder(SuiteRun(protocol=protocol.name, protocol_hash=protocol.hash, policy=policy), out)
    left = [drive for drive in drives if not (out / drive.folder / ROLLOUT).is_file()]
    reused = len(drives) - len(left)
    reporter.start("drives", len(left))
    failed: dict[str, str] = {}
    if left:
        failed = _drive_part(suite, policy, left, out, workers, reporter, preflight=True)
    for _ in range(_ROUNDS - 1):
        left = [drive for drive in left if drive.folder in failed]
        failed = {}
        # Each in a process of its own, so that a drive that ends its process ends no other.
        for drive in left:
            failed |= _drive_part(suite, policy, [drive], out, 1, reporter)
    rollouts = {drive.folder: read_rollout(out / drive.folder) for drive in drives if drive.folder not in failed}
    endings = Counter(rollout.ending for rollout in rollouts.values())
    errors = {name: one.reason or "" for name, one in rollouts.items() if one.ending == "policy"}
    return SuiteOutcome(len(drives), reused, dict(sorted(endings.items())), errors, failed)


def _open_folder(run: SuiteRun, out: Path) -> None:
    require_output_folder(out, FolderKind.SUITE)
    file = out / SUITE_FILE
    if not file.is_file():
        write_json(file, run)
        return
    earlier = read_json(file, SuiteRun)
    for name in ("protocol", "protocol_hash", "policy"):
        if getattr(earlier, name) != getattr(run, name):
            raise UsageError(
                f"the drives in it are of another suite or policy: {name} is {getattr(earlier, name)!r}",
                file=file, place="--out", expected=repr(getattr(run, name)), remedy="name another folder with --out",
            )  # fmt: skip


def _drive_part(
    suite: Suite,
    policy: str,
    drives: Sequence[SuiteDrive],
    out: Path,
    workers: int,
    reporter: ProgressReporter,
    *,
    preflight: bool = False,
) -> dict[str, str]:
    """Drive in worker processes, and return the failures of the machine by the drive's folder."""
    failed: dict[str, str] = {}
    with process_pool(min(workers, len(drives)), _begin) as pool:
        if preflight:
            _require_policy(pool.submit(_drive_briefly, suite, policy, drives[0]))
        running = {pool.submit(_drive_whole, suite, policy, drive, out / drive.folder): drive for drive in drives}
        for done in as_completed(running):
            try:
                done.result()
            except (OSError, MemoryError, DatasetError) as error:
                failed[running[done].folder] = f"{type(error).__name__}: {error}"
            except BrokenProcessPool:
                failed[running[done].folder] = "its process ended"
            else:
                reporter.advance(1)
    return failed


def _require_policy(preflight: Future[str | None]) -> None:
    try:
        problem = preflight.result()
    except BrokenProcessPool:
        problem = "its process ended"
    if problem is not None:
        raise UsageError(
            f"the policy fails in a drive of {_PREFLIGHT_S:g} s: {problem}", place="--policy",
            expected="a policy that drives", remedy="mend the policy; no drive was begun",
        ) from None  # fmt: skip


def _begin() -> None:
    """Begin a worker: nothing is to be done."""


def _drive_briefly(suite: Suite, policy: str, drive: SuiteDrive) -> str | None:
    """Drive the first second, and return the policy's error."""
    short = drive.scenario.model_copy(update={"duration_s": min(_PREFLIGHT_S, suite.duration_s)})
    with tempfile.TemporaryDirectory(prefix="mirror-preflight-") as folder:
        result = _drive(suite, policy, replace(drive, scenario=short), Path(folder) / "drive")
    return None if result.error is None else str(result.error)


def _drive_whole(suite: Suite, policy: str, drive: SuiteDrive, out: Path) -> None:
    _drive(suite, policy, drive, out)


def _drive(suite: Suite, name: str, drive: SuiteDrive, out: Path) -> RolloutResult:
    street = open_street(drive.street.source)
    if street.scene_id != drive.street.scene:
        raise UsageError(
            f"{drive.street.source} is scene {street.scene_id!r}", place="suite.streets", expected=drive.street.scene
        )
    policy = make_policy(name)
    unknown = [camera for camera in policy.cameras if camera not in suite.cameras]
    if unknown:
        raise UsageError(
            f"policy {name!r} asks for camera {unknown[0]!r}", place="--policy",
            expected=f"some of {', '.join(suite.cameras)}",
        )  # fmt: skip
    request = RolloutRequest(
        street=street, scenario=drive.scenario, policy=policy, policy_name=name,
        cameras=rig_cameras(street, tuple(policy.cameras), suite.width_px), factory=RendererFactory(suite.renderer),
        deadline_s=suite.deadline_s, scenario_file=f"{drive.scenario.name}.toml",
    )  # fmt: skip
    return run_rollout(request, out)
