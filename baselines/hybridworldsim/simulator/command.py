"""The command line of ``mirror simulate``."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybridworldsim.simulator.arguments import Arguments
from mirror.command_line import parse_arguments
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from hybridworldsim.simulator.rollout.run import RolloutResult

_EXAMPLES = (
    "mirror simulate demo/block/dataset --scenario hard-brake --policy idm --out rollout",
    "mirror simulate demo/block/dataset demo/block/model --scenario cut-in --policy idm --out rollout",
)
_PLACES = {"source": "DATASET", "begin": "--from"}


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror simulate", examples=_EXAMPLES)
    if arguments.suite is not None:
        return _drive_suite(arguments, arguments.suite)
    if arguments.workers is not None:
        raise UsageError("a single drive has one process", place="--workers", expected="--suite NAME")
    for option, given in (("--policy-folder", arguments.policy_folder), ("--secret", arguments.secret)):
        if given is not None:
            raise UsageError(f"{given}", place=option, expected="--suite NAME beside it")
    if arguments.policy is not None and arguments.policy.partition(":")[0] in ("sandbox", "container"):
        raise UsageError(
            f"{arguments.policy!r} in a single drive", place="--policy", expected="--suite NAME beside it",
            remedy="drive a suite, or serve the policy and name its address: grpc://HOST:PORT",
        )  # fmt: skip

    from hybridworldsim.simulator.rollout.run import require_new_rollout, run_rollout
    from hybridworldsim.simulator.single_drive import make_request
    from mirror.progress import progress_bar

    require_new_rollout(arguments.out)
    request = make_request(arguments)
    with progress_bar(quiet=arguments.json) as bar:
        result = run_rollout(request, arguments.out, bar)
    same = None if arguments.replay is None else _has_same_states(arguments.replay, arguments.out)
    if arguments.json:
        print(json.dumps(_plain(result, same)))
    else:
        _print(result, same)
    return ExitCode.FINDINGS if result.error is not None or same is False else ExitCode.DONE


def _drive_suite(arguments: Arguments, suite: str) -> int:
    from hybridworldsim.simulator.isolation.choice import PolicyChoice
    from hybridworldsim.simulator.suite import drive_suite, require_suite
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.suite import read_secret

    kept = ("policy", "policy_folder", "secret", "out", "suite", "workers", "json")
    for field in fields(Arguments):
        if field.name not in kept and getattr(arguments, field.name) != field.default:
            raise UsageError(
                "the suite states it", place=_PLACES.get(field.name, f"--{field.name}"),
                expected="--suite, --policy, --policy-folder, --secret, --out, --workers and --json alone",
            )  # fmt: skip
    if arguments.policy is None or "://" in arguments.policy:
        raise UsageError(
            arguments.policy or "no policy", place="--policy",
            expected="an installed policy, FILE.py:CLASS, sandbox:COMMAND or container:IMAGE",
        )  # fmt: skip
    workers = arguments.workers if arguments.workers is not None else os.cpu_count() or 1
    if workers < 1:
        raise UsageError(f"{workers} processes", place="--workers", expected="at least 1")
    protocol = load_protocol(suite)
    policy = PolicyChoice.parse(arguments.policy, arguments.policy_folder)
    secret = read_secret(arguments.secret, require_suite(protocol), protocol.name)
    with progress_bar(quiet=arguments.json) as bar:
        done = drive_suite(protocol, policy, arguments.out, workers=workers, reporter=bar, secret=secret)
    if arguments.json:
        print(json.dumps({"run": str(arguments.out), **asdict(done)}))
    else:
        endings = ", ".join(f"{count} by {ending.replace('_', ' ')}" for ending, count in done.endings.items())
        print(f"{arguments.out}: {done.drives} drives, {done.reused} of them driven before; ended {endings}")
        for what, errors in (("the policy failed", done.policy_errors), ("the machine failed", done.machine_errors)):
            for folder, reason in errors.items():
                print(f"  {what} in {folder}: {reason}")
        if not done.machine_errors:
            print(f"next: mirror evaluate {arguments.out} --protocol {suite} --report")
        else:
            print("next: repeat the command, which drives what is missing")
    if done.machine_errors:
        return ExitCode.PARTLY_DONE
    return ExitCode.FINDINGS if done.policy_errors else ExitCode.DONE


def _has_same_states(earlier: Path, later: Path) -> bool:
    from mirror.schema.rollout import STATES_FILE

    return (earlier / STATES_FILE).read_bytes() == (later / STATES_FILE).read_bytes()


def _plain(result: RolloutResult, same: bool | None) -> dict[str, Any]:
    rollout = result.rollout
    return {
        "run": str(result.folder),
        "ending": rollout.ending,
        "reason": rollout.reason,
        "steps": rollout.steps,
        "rendered": result.rendered,
        "road_map": rollout.map_source,
        "views": rollout.views,
        "same_states": same,
        "safety": {
            name: figure.value if math.isfinite(figure.value) else None
            for name, figure in result.safety.figures.items()
        },
    }


def _print(result: RolloutResult, same: bool | None) -> None:
    from hybridworldsim.simulator.rollout.run import describe_map, describe_safety, describe_views

    rollout = result.rollout
    worst, *others = describe_safety(result.safety)
    if rollout.reason is None:
        print(f"{result.folder}: {worst}; {rollout.steps} steps, ended by {rollout.ending.replace('_', ' ')}")
    else:
        print(f"{result.folder}: the policy failed after {rollout.steps} steps\n  {rollout.reason}")
        print(f"  until then {worst}")
    for line in others:
        print(f"  {line}")
    print(f"  {describe_map(rollout.map_source)}")
    if rollout.views is not None:
        print(f"  at {rollout.rate_hz:g} Hz; views: {describe_views(rollout.views)}")
    if same is not None:
        print("  the states are those of the earlier rollout, bit for bit" if same else "  the states differ")
    print(f"next: mirror evaluate {result.folder} --protocol safety")
