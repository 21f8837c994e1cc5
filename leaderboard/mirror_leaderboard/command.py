"""``mirror leaderboard``: build, add, sign, key, rotate."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.counting import count_of
from mirror.errors import ExitCode, UsageError
from mirror.progress import progress_bar
from mirror_leaderboard.refused import RefusedError

PAPERS: Final = Path(__file__).parent / "papers"
"""The board of figures that papers report."""
BOARD: Final = Path("leaderboard")
"""The default board."""

_BUILD_EXAMPLES = (
    "mirror leaderboard build --papers --out site",
    "mirror leaderboard build --board demo/board --unsigned --out site",
)
_ADD_EXAMPLES = (
    "mirror leaderboard add demo/results/mean_color/result.json demo/dataset --dataset-name 'my street'"
    " --submission demo/submissions/mean_color --board board",
    "mirror leaderboard add scores/result.json rollouts --dataset-name 'my street' --street synth:block"
    " --scenarios scenarios --board board",
)
_SIGN_EXAMPLES = (
    "mirror leaderboard sign --board demo/board --key organiser.key",
    "mirror leaderboard sign --key organiser.key",
)
_ROTATE_EXAMPLES = (
    "mirror leaderboard rotate --key new.key",
    "mirror leaderboard rotate --board demo/board --key new.key",
)
_KEY_EXAMPLES = ("mirror leaderboard key --out organiser.key", "mirror leaderboard key --out ~/organiser.key")
_ADD_RENAMED = {"--dataset": "--dataset-name", "--truth": "[DATASET]"}


@dataclass(frozen=True)
class Build:
    """Write the site of the leaderboard as static files. A browser opens its index.html without a server."""

    out: Path = Path("site")
    """Folder for the site."""
    board: Annotated[Path | None, help_text(default="./leaderboard if it is a board", metavar="FOLDER")] = None
    """Board to show: a folder that `mirror leaderboard add` wrote."""
    also: Annotated[tuple[Path, ...], help_text(default="none", metavar="FOLDER")] = ()
    """More boards. An entry replaces the same entry of a board before it."""
    papers: Annotated[bool, help_text(default="only if there is no board")] = False
    """Show the figures that papers report too, in tables of their own behind the measured ones."""
    unsigned: bool = False
    """Build a draft: entries without signature and review are shown, and the page says so."""


@dataclass(frozen=True, kw_only=True)
class Add:
    """Add a result to a board, after checks of its hashes, its protocol and its values."""

    result: tyro.conf.Positional[Path]
    """`result.json` of `mirror evaluate`."""
    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset: the result is held against its plan. For the protocol safety: the folder of the
    rollouts, which are scored again."""
    dataset_name: Annotated[str, help_text(metavar="NAME")]
    """Name of the dataset on the board."""
    setting: Annotated[str | None, help_text(default="none")] = None
    """Setting that distinguishes this row from others of the same method and version."""
    submission: Annotated[Path | None, help_text(default="none", metavar="FOLDER")] = None
    """Score the renders of this submission again. Without it, the row stands in a table of unverified ones."""
    hidden: Annotated[Path | None, help_text(default="none", metavar="FOLDER")] = None
    """Folder of the hidden truth, for protocols that use it."""
    extractor: Annotated[str | None, help_text(default="diff-grabcut", metavar="NAME")] = None
    """Extractor of edited regions, as of `mirror evaluate`. With another than diff-grabcut, the row is unverified."""
    features: Annotated[Path | None, help_text(default="none", metavar="FOLDER")] = None
    """Folder of cached features of true images, which evaluations may share."""
    measure: Annotated[str | None, help_text(default="none", metavar="METHOD=MODEL")] = None
    """Protocol runtime: measure the speed of this method (an installed one, or FILE.py:OBJECT) with its model. Without
    it, all figures are stated ones, and the row stands in a table that says so."""
    workers: int = 2
    """Number of processes that score again."""
    street: Annotated[tuple[str, ...], help_text(default="none", metavar="DATASET|synth:PRESET ...")] = ()
    """Protocol safety: drive the recorded controls again in these streets, with all of --scenarios in each. Each scene
    of a dataset is a street. Without it, the row stands in a table of unverified ones."""
    again: bool = False
    """Protocol with a suite: drive the recorded controls of all its drives again: the badge *states verified*. Without
    it, the row stands in a table of unverified ones."""
    ran_here: bool = False
    """Protocol with a suite: you drove the rollouts yourself, with the policy in a sandbox or a container: the badge
    *policy run by the organiser*. A suite with a secret takes no other rows."""
    secret: Annotated[Path | None, help_text(default="none", metavar="FILE")] = None
    """Protocol with a suite with a secret: your file of it."""
    scenarios: Annotated[Path | None, help_text(default="none", metavar="FOLDER")] = None
    """Scenarios (.toml) that were asked for, each with its seed; one rollout of each is required."""
    map: Annotated[Path | None, help_text(default="exact, or recorded, or fitted", metavar="FILE")] = None
    """Road map of --street, as `mirror simulate --map` took it."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """Layer of boxes of --street, as `mirror simulate --boxes` took it."""
    board: Annotated[Path, help_text(metavar="FOLDER")] = BOARD
    """Folder of the board, created if it does not exist."""


@dataclass(frozen=True, kw_only=True)
class SignArguments:
    """Sign the measured entries of a board that have no valid signature; a board's first key is listed in keys.json."""

    key: Path
    """File of the organiser's private key."""
    board: Annotated[Path, help_text(metavar="FOLDER")] = BOARD
    """Folder of the board."""


@dataclass(frozen=True, kw_only=True)
class Rotate:
    """Replace a lost or former organiser's key, and sign all entries again that a listed key had signed.

    The former public key stays in keys.json with the day on which it ended. Entries without a valid signature are left.
    """

    key: Path
    """File of the new private key, from `mirror leaderboard key`."""
    board: Annotated[Path, help_text(metavar="FOLDER")] = BOARD
    """Folder of the board."""


@dataclass(frozen=True, kw_only=True)
class Key:
    """Make an organiser's key (ed25519) for signing the entries of a board."""

    out: Path
    """New file for the private key, outside the board. Only its owner can read it."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    subcommands = {
        "build": Subcommand("write the static site", _build),
        "add": Subcommand("put a result.json on the board", _add),
        "sign": Subcommand("sign the measured entries of a board", _sign),
        "rotate": Subcommand("replace the organiser's key", _rotate),
        "key": Subcommand("make an organiser's key", _key),
    }
    try:
        return run_subcommand(argv, "mirror leaderboard", subcommands)
    except RefusedError as error:
        print(f"mirror leaderboard {argv[0]}: refused: {error}", file=sys.stderr)
        return ExitCode.FINDINGS


def _build(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Build, argv, "mirror leaderboard build", examples=_BUILD_EXAMPLES)
    from mirror_leaderboard.site.page import build

    has_default = arguments.board is None and (BOARD / "entries").is_dir()
    boards = (BOARD,) if has_default else () if arguments.board is None else (arguments.board,)
    boards = (*boards, *arguments.also)
    papers = (PAPERS,) if arguments.papers or not boards else ()
    print(f"site: {build((*papers, *boards), arguments.out, unsigned=arguments.unsigned)}")
    return ExitCode.DONE


def _read_secret(arguments: Add) -> bytes | None:
    from mirror.protocols.suite import read_secret
    from mirror_leaderboard.add import read_result

    if not (arguments.again or arguments.ran_here or arguments.secret):
        return None
    protocol = read_result(arguments.result).protocol
    if protocol.suite is None:
        raise UsageError(
            f"protocol {protocol.name} has no suite", place="--again, --ran-here, --secret",
            expected="a result of a suite, such as closed-loop",
        )  # fmt: skip
    return read_secret(arguments.secret, protocol.suite, protocol.name)


def _add(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Add, argv, "mirror leaderboard add", examples=_ADD_EXAMPLES, renamed=_ADD_RENAMED)
    from mirror_leaderboard.add import add_result
    from mirror_leaderboard.rescore import RolloutPlan, Sources, SuitePlan

    if arguments.submission is None and arguments.hidden is not None:
        raise UsageError("--hidden requires --submission", expected="both, or neither")
    if arguments.submission is None and arguments.extractor is not None:
        raise UsageError("--extractor requires --submission", expected="both, or neither")
    if bool(arguments.street) != (arguments.scenarios is not None):
        raise UsageError("only one of --street and --scenarios", expected="both, or neither")
    plan: RolloutPlan | SuitePlan | None = None
    secret = _read_secret(arguments)
    if arguments.again:
        if arguments.scenarios is not None:
            raise UsageError("--again and --scenarios", expected="the drives of a suite, or those of a folder")
        plan = SuitePlan()
    elif arguments.scenarios is not None:
        plan = RolloutPlan(arguments.street, arguments.scenarios, arguments.map, arguments.boxes)
    elif arguments.map is not None or arguments.boxes is not None:
        raise UsageError("--map and --boxes belong to a street", expected="--street and --scenarios with them")
    measured = None
    if arguments.measure is not None:
        name, _, model = arguments.measure.partition("=")
        if not (name and model and arguments.submission):
            raise UsageError(repr(arguments.measure), place="--measure", expected="METHOD=MODEL, and --submission")
        measured = name, Path(model)
    sources = Sources(
        arguments.dataset,
        arguments.submission,
        arguments.hidden,
        arguments.features,
        extractor=arguments.extractor,
        plan=plan,
        secret=secret,
        ran_here=arguments.ran_here,
        measured=measured,
        workers=arguments.workers,
    )
    with progress_bar(quiet=False) as bar:
        entry = add_result(
            arguments.result,
            arguments.board,
            arguments.dataset_name,
            setting=arguments.setting,
            sources=sources,
            progress=bar,
        )
    print(f"entry: {entry}")
    print(f"next: mirror leaderboard sign --board {arguments.board} --key FILE")
    return ExitCode.DONE


def _key(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Key, argv, "mirror leaderboard key", examples=_KEY_EXAMPLES)
    from mirror_leaderboard.signing import new_key

    public = new_key(arguments.out)
    print(f"private key: {arguments.out} (keep it secret)")
    print(f"public key: {public}")
    return ExitCode.DONE


def _sign(argv: Sequence[str]) -> int:
    arguments = parse_arguments(SignArguments, argv, "mirror leaderboard sign", examples=_SIGN_EXAMPLES)
    from mirror_leaderboard.trust import sign_entries

    signed = sign_entries(arguments.board, arguments.key)
    for entry in signed:
        print(f"signed: {entry.method} {entry.version}, {entry.protocol}, {entry.dataset}")
    print(f"signed: {count_of(len(signed), 'entry')}")
    return ExitCode.DONE


def _rotate(argv: Sequence[str]) -> int:
    arguments = parse_arguments(Rotate, argv, "mirror leaderboard rotate", examples=_ROTATE_EXAMPLES)
    from mirror_leaderboard.trust import rotate_key

    done = rotate_key(arguments.board, arguments.key)
    print(f"key {done.former.id} ended on {done.former.until}; key {done.current.id} is in use")
    print(f"signed again: {count_of(len(done.signed), 'entry')}")
    for entry in done.left:
        print(f"left without a valid signature: {entry.method} {entry.version}, {entry.protocol}, {entry.dataset}")
    return ExitCode.FINDINGS if done.left else ExitCode.DONE
