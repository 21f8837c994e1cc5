"""The command line of ``mirror simulate``."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from hybridworldsim.simulator.rollout.run import RolloutResult

_EXAMPLES = (
    "mirror simulate demo/block/dataset --scenario hard-brake --policy idm --out rollout",
    "mirror simulate demo/block/dataset demo/block/model --scenario cut-in --policy idm --out rollout",
)
_PLACES = {"source": "DATASET", "begin": "--from"}


@dataclass(frozen=True)
class Arguments:
    """Drive a scenario with a policy. --out receives the states, the map, the controls and a video of the cameras.

    A collision ends the drive. The exit code is 1 if the policy failed or was too slow; the states up to there are
    complete. `mirror evaluate RUN --protocol safety` scores the folder.
    """

    out: Annotated[Path, help_text(metavar="RUN")]
    """A new folder; with --suite, also one with drives of the same suite and policy, which are kept."""
    source: Annotated[
        tyro.conf.Positional[str | None],
        help_text(default="required without --suite", metavar="DATASET|synth:PRESET"),
    ] = None
    """Folder or URL of a dataset, or a synthetic street, synth:PRESET[:SEED[:DRIVE]]."""
    model: Annotated[tyro.conf.Positional[Path | None], help_text(default="none", metavar="MODEL")] = None
    """Folder of a model of the scene, which `mirror reconstruct` wrote: it renders the images."""
    scenario: Annotated[str | None, help_text(default="that of --replay", metavar="NAME|FILE.toml")] = None
    """Name of a scenario, or path of its .toml file."""
    policy: Annotated[str | None, help_text(default="the controls of --replay", metavar="NAME|FILE.py:CLASS|...")] = (
        None
    )
    """An installed policy (idm, log, stop, constant-velocity, or another one of the entry points mirror.policies), a
    class in a file, or the address grpc://HOST:PORT of a driver that serves AlpaSim's EgodriverService; the connection
    is not encrypted. With --suite also sandbox:FILE.py:CLASS, sandbox:COMMAND and container:IMAGE: the policy runs
    apart, without network and files of this machine."""
    policy_folder: Annotated[Path | None, help_text(default="that of FILE.py, or none", metavar="FOLDER")] = None
    """With --policy sandbox:...: the files that the policy sees, as /policy."""
    secret: Annotated[Path | None, help_text(default="none", metavar="FILE")] = None
    """With --suite: the organiser's secret, from which the parameters of a test split's scenarios follow."""
    driver: Annotated[Path | None, help_text(default="front_wide as JPEG, 30 s", metavar="FILE.toml")] = None
    """Cameras, lens, image format and deadline of a driver at an address."""
    renderer: Annotated[
        Literal["boxes", "exact", "reconstructed", "generated"] | None,
        help_text(default="that of the generator or the model, exact for a synthetic street, else boxes"),
    ] = None
    """Renderer of the images: wireframes, the synthetic street, a trained model, or one with generated road users."""
    generator: Annotated[Path | None, help_text(default="none", metavar="FOLDER")] = None
    """Generator of road users, which `mirror generate train` wrote, over the street of MODEL. The drive runs at the
    rate of its training."""
    hz: Annotated[float | None, help_text(default="that of the generator's training")] = None
    """With --generator: steps of the drive in a second."""
    sampler_steps: int = 4
    """Steps of the generator's sampler."""
    blend: Annotated[str, help_text(metavar="PIXELS|none")] = "4"
    """Use generated pixels only in the hulls of boxes, grown by this many pixels; elsewhere the street stays. none: use
    them everywhere."""
    fallback: Annotated[Literal["reconstructed"] | None, help_text(default="refuse such a scenario")] = None
    """Renderer of views with agents of a class that the generator does not know."""
    method: Annotated[str | None, help_text(default="the installed one of the model", metavar="FILE.py:OBJECT")] = None
    """The file of MODEL's method, if that is not installed: that of the training."""
    device: Annotated[str | None, help_text(default="auto", metavar="auto|cpu|cuda[:N]")] = None
    """Device of MODEL and the generator. auto: a GPU that torch and gsplat can use, else the CPU. The first
    line says which."""
    scene: Annotated[str | None, help_text(default="the only one", metavar="ID")] = None
    """Scene of the dataset."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes that are the recorded road users: labels of people, or of a version of an annotator."""
    map: Annotated[Path | None, help_text(default="exact, or recorded, or fitted", metavar="FILE")] = None
    """Road map of the scene, as GeoParquet. By default that of the synthetic street; for a dataset its recorded map,
    which `mirror ingest --map` added, or else one that is fitted to the driven lines."""
    cameras: Annotated[str | None, help_text(default="all of the rig", metavar="NAME,...")] = None
    """Cameras of the video. The policy gets the cameras that it asks for."""
    width: int = 240
    """Width of the images."""
    height: Annotated[int | None, help_text(default="in proportion")] = None
    """Height of the images."""
    video: bool = True
    """Write a video of the cameras with a bird's-eye view beside them."""
    report: bool = False
    """Write report.html: the video, curves over its time, events, and the figures of the safety."""
    duration: Annotated[float | None, help_text(default="that of the scenario", metavar="SECONDS")] = None
    """Duration of the drive."""
    seed: Annotated[int | None, help_text(default="that of the scenario")] = None
    """Seed of the rollout."""
    deadline: Annotated[float | None, help_text(default="none", metavar="SECONDS")] = None
    """Longest time that the policy may take for an action."""
    replay: Annotated[Path | None, help_text(default="none", metavar="RUN")] = None
    """Repeat the controls of an earlier rollout on its street, with its scenario and seed, and compare the states."""
    begin: Annotated[Path | None, help_text(name="from", default="none", metavar="RUN")] = None
    """With --at and --policy: go on from an instant of an earlier rollout, on its street, with its scenario and seed.
    Its controls are driven up to there, while the policy observes."""
    at: Annotated[float | None, help_text(default="none", metavar="SECONDS")] = None
    """With --from: the instant from which the policy drives."""
    suite: Annotated[str | None, help_text(default="none", metavar="NAME|FILE.toml")] = None
    """Drive all drives of a protocol with a suite, such as closed-loop; of the options, only --policy, --policy-folder,
    --secret, --out, --workers and --json count. Repeat the command after an interruption."""
    workers: Annotated[int | None, help_text(default="the number of cores")] = None
    """Number of processes of --suite."""
    json: bool = False
    """Print JSON."""


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
