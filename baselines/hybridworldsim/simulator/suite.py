"""Drives the suite of a protocol: in parallel, resumable, with the same bytes for any number of workers."""

from __future__ import annotations

import tempfile
from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Final

from hybridworldsim.simulator.isolation.choice import PolicyChoice
from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.renderers.registry import RendererFactory
from hybridworldsim.simulator.rollout.run import RolloutRequest, RolloutResult, remove_mark, run_rollout
from hybridworldsim.simulator.street.opening import open_street
from hybridworldsim.simulator.street.street import Street
from mirror.errors import DatasetError, UsageError
from mirror.pools import ProcessPool, process_pool
from mirror.progress import ProgressReporter
from mirror.protocols.document import Protocol
from mirror.protocols.suite import Suite, SuiteDrive, SuiteStreet, list_drives
from mirror.schema.files import read_json, remove_temporaries, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.rollout import BY_POLICY, ROLLOUT, read_rollout
from mirror.schema.suite_run import SUITE_FILE, SuiteRun

_ROUNDS: Final = 3
"""Number of times that a drive is begun if the machine fails each time."""
_PREFLIGHT_S: Final = 1.0
_STREETS_HELD: Final = 2


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
    protocol: Protocol,
    policy: PolicyChoice,
    out: Path,
    *,
    workers: int,
    reporter: ProgressReporter,
    secret: bytes | None = None,
) -> SuiteOutcome:
    """Drive what is missing of a suite, after a preflight of one second.

    Each drive has a policy of its own. A drive whose machine fails (its process ends, memory or the disk is full) is
    begun again, from the second time on alone in a process.

    Args:
        protocol: a protocol with a suite.
        policy: the policy, and how it is kept apart from this machine.
        out: folder of the rollouts: new, empty, or that of the same suite and policy.
        workers: number of worker processes.
        reporter: receives the progress.
        secret: the organiser's secret of the suite; None: it has none.

    Raises:
        UsageError: the folder is another one's, the protocol has no suite, the policy asks for a camera that the suite
            lacks, fails in the preflight, or is not kept apart in a suite with a secret, or a scenario does not fit on
            its street.
        DatasetError: the folder cannot be written.
    """
    suite = require_suite(protocol)
    if suite.is_secret and policy.isolation is None:
        raise UsageError(
            f"a policy in this process could read the secret of {protocol.name}", place="--policy",
            expected="sandbox:COMMAND or container:IMAGE",
        )  # fmt: skip
    policy.require_available()
    drives = list_drives(suite, secret)
    run = SuiteRun(
        protocol=protocol.name, protocol_hash=protocol.hash, policy=policy.name, isolation=policy.isolation
    )  # fmt: skip
    _open_folder(run, out)
    left = [drive for drive in drives if not (out / drive.folder / ROLLOUT).is_file()]
    reused = len(drives) - len(left)
    unfinished = {drive.folder for drive in left}
    for folder in (drive.folder for drive in drives if drive.folder not in unfinished):
        remove_mark(out / folder)
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
    errors = {name: one.reason or "" for name, one in rollouts.items() if one.ending in BY_POLICY}
    return SuiteOutcome(len(drives), reused, dict(sorted(endings.items())), errors, failed)


def _open_folder(run: SuiteRun, out: Path) -> None:
    require_output_folder(out, FolderKind.SUITE)
    if out.is_dir():
        # What a killed command left.
        remove_temporaries(out)
    file = out / SUITE_FILE
    # A command that was refused in the preflight leaves its document and no drive: the mended one replaces it.
    if not file.is_file() or not any(path.is_dir() for path in out.iterdir()):
        write_json(file, run)
        return
    earlier = read_json(file, SuiteRun)
    for name in ("protocol", "protocol_hash", "policy", "isolation"):
        if getattr(earlier, name) != getattr(run, name):
            raise UsageError(
                f"the drives in it are of another suite or policy: {name} is {getattr(earlier, name)!r}",
                file=file, place="--out", expected=repr(getattr(run, name)), remedy="name another folder with --out",
            )  # fmt: skip


@dataclass
class _Worker:
    """A process with the drives of one street before it, so that few processes open the same street."""

    pool: ProcessPool | None = None
    opened: ExitStack = field(default_factory=ExitStack)
    drives: deque[SuiteDrive] = field(default_factory=deque)

    def submit(self, suite: Suite, policy: PolicyChoice, drive: SuiteDrive, out: Path) -> Future[None]:
        if self.pool is None:
            self.pool = self.opened.enter_context(process_pool(1, _begin))
        return self.pool.submit(_drive_whole, suite, policy, drive, out / drive.folder)

    def end(self) -> None:
        """End the process; the next drive begins another one."""
        self.opened.close()
        self.pool = None


def _drive_part(
    suite: Suite,
    policy: PolicyChoice,
    drives: Sequence[SuiteDrive],
    out: Path,
    workers: int,
    reporter: ProgressReporter,
    *,
    preflight: bool = False,
) -> dict[str, str]:
    """Drive in worker processes, and return the failures of the machine by the drive's folder."""
    failed: dict[str, str] = {}
    streets: deque[deque[SuiteDrive]] = deque()
    for scene in dict.fromkeys(drive.street.scene for drive in drives):
        streets.append(deque(drive for drive in drives if drive.street.scene == scene))
    with ExitStack() as stack:
        team = [_Worker() for _ in range(min(workers, len(drives)))]
        for worker in team:
            stack.callback(worker.end)
        if preflight:
            first = team[0]
            first.pool = first.opened.enter_context(process_pool(1, _begin))
            _require_policy(first.pool.submit(_drive_briefly, suite, policy, drives[0]))
        running: dict[Future[None], tuple[_Worker, SuiteDrive]] = {}
        for worker in team:
            _begin_next(worker, team, streets, running, suite, policy, out)
        while running:
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                worker, drive = running.pop(done)
                try:
                    done.result()
                except (OSError, MemoryError, DatasetError) as error:
                    failed[drive.folder] = f"{type(error).__name__}: {error}"
                except BrokenProcessPool:
                    failed[drive.folder] = "its process ended"
                    worker.end()
                else:
                    reporter.advance(1)
                _begin_next(worker, team, streets, running, suite, policy, out)
    return failed


def _begin_next(
    worker: _Worker,
    team: Sequence[_Worker],
    streets: deque[deque[SuiteDrive]],
    running: dict[Future[None], tuple[_Worker, SuiteDrive]],
    suite: Suite,
    policy: PolicyChoice,
    out: Path,
) -> None:
    """Begin a worker's next drive: of its street, else of a street that nobody has, else of the longest remainder."""
    if not worker.drives:
        if streets:
            worker.drives = streets.popleft()
        else:
            longest = max(team, key=lambda other: len(other.drives)).drives
            worker.drives = deque(longest.pop() for _ in range(len(longest) // 2))
            worker.drives.reverse()
    if worker.drives:
        drive = worker.drives.popleft()
        running[worker.submit(suite, policy, drive, out)] = worker, drive


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


def _drive_briefly(suite: Suite, policy: PolicyChoice, drive: SuiteDrive) -> str | None:
    """Drive the first second, and return the policy's error."""
    short = drive.scenario.model_copy(update={"duration_s": min(_PREFLIGHT_S, suite.duration_s)})
    with tempfile.TemporaryDirectory(prefix="mirror-preflight-") as folder:
        result = _drive(suite, policy, replace(drive, scenario=short), Path(folder) / "drive")
    return None if result.error is None else str(result.error)


def _drive_whole(suite: Suite, policy: PolicyChoice, drive: SuiteDrive, out: Path) -> None:
    _drive(suite, policy, drive, out)


def open_suite_street(street: SuiteStreet) -> Street:
    """Open a street of a suite, whose scene has the suite's name of it.

    Raises:
        UsageError: there is no such street, or it is another scene.
    """
    return _open_suite_street(street.source, street.scene)


@lru_cache(maxsize=_STREETS_HELD)
def _open_suite_street(source: str, scene: str) -> Street:
    street = open_street(source)
    if scene != street.scene_id and not scene.startswith(f"{street.scene_id}-"):
        raise UsageError(f"{source} is scene {street.scene_id!r}", place="suite.streets", expected=scene)
    return replace(street, scene_id=scene)


def _drive(suite: Suite, choice: PolicyChoice, drive: SuiteDrive, out: Path) -> RolloutResult:
    street = open_suite_street(drive.street)
    policy = choice.make(suite)
    unknown = [camera for camera in policy.cameras if camera not in suite.cameras]
    if unknown:
        raise UsageError(
            f"policy {choice.name!r} asks for camera {unknown[0]!r}", place="--policy",
            expected=f"some of {', '.join(suite.cameras)}",
        )  # fmt: skip
    request = RolloutRequest(
        street=street, scenario=drive.scenario, policy=policy, policy_name=choice.name,
        cameras=rig_cameras(street, tuple(policy.cameras), suite.width_px), factory=RendererFactory(suite.renderer),
        deadline_s=choice.deadline_s(suite), ends_off_road=suite.ends_off_road, sensors=drive.sensors,
        scenario_file=f"{drive.scenario.name}.toml",
    )  # fmt: skip
    return run_rollout(request, out)
