"""Makes an entry from a ``result.json``, after checks of its hashes, its protocol and its values."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Final

from pydantic import TypeAdapter, ValidationError

from mirror.errors import DatasetError, UsageError
from mirror.evaluation.extractors import DEFAULT_EXTRACTOR
from mirror.evaluation.result import GroupFigure, Result
from mirror.evaluation.submission.untrusted import parse_untrusted
from mirror.metrics.catalogue import find_measure
from mirror.progress import ProgressReporter
from mirror.protocols.document import commit_to_secret, load_protocol, protocol_names
from mirror.protocols.ranking import ALL
from mirror.schema.files import read_json, unwritable_error, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.problems import describe_problem, describe_problem_and_value
from mirror.schema.suite_run import SUITE_FILE, Isolation, SuiteRun
from mirror.version import __version__
from mirror_leaderboard.entry import (
    COMMITMENT,
    IMAGE_FOLDER,
    Cluster,
    Entry,
    Figure,
    Link,
    Measured,
    entry_key,
    load_entries,
)
from mirror_leaderboard.images import copy_pairs
from mirror_leaderboard.names import find_name_problem, skeleton
from mirror_leaderboard.recount import require_recomputed_means
from mirror_leaderboard.refused import RefusedError
from mirror_leaderboard.rescore import MEASURED_HERE, Sources, require_plan, rescore
from mirror_leaderboard.rollouts import rescore_rollouts
from mirror_leaderboard.trust import today

_MAX_BYTES: Final = 64 << 20
_LINK: Final[TypeAdapter[str]] = TypeAdapter(Link)
_MAX_NOTE_CHARACTERS: Final = 400
_RUNTIME_GROUPS: Final = ("reported", MEASURED_HERE)


def add_result(
    path: Path,
    board: Path,
    dataset: str,
    *,
    setting: str | None = None,
    sources: Sources | None = None,
    progress: ProgressReporter | None = None,
    day: date | None = None,
) -> Path:
    """Validate a result and write its entry.

    Args:
        path: path of ``result.json``.
        board: folder of the board, with its entries and images; created if it does not exist.
        dataset: name of the dataset on the board.
        setting: setting that distinguishes this row from others of the same method and version.
        sources: dataset that the result is held against. With its submission, the renders are scored again, and a few
            are shown beside their truth; without, the entry stands in a table of unverified ones. None: the result is
            held against its own table of images alone. For the protocol safety: the rollouts, which are always scored
            again from their state logs, and the plan on which their controls are driven again.
        progress: receives the progress of the scoring.
        day: day of the entry; None: today (UTC).

    Returns:
        The new entry's file.

    Raises:
        UsageError: ``board`` is another kind of folder, or a plan of rollouts is given for another protocol.
        RefusedError: the result is inconsistent, or is on the board already.
        DatasetError: the file cannot be read, or the entry cannot be written.
        SchemaError: an existing entry is broken.
    """
    require_output_folder(board, FolderKind.BOARD, place="--board")
    result = read_result(path)
    entry = make_entry(result, dataset, file=path, setting=setting)
    _require_name(entry.method, "submission.method.name", path)
    for name in filter(None, (entry.version, entry.setting, dataset)):
        _require_name(name, "version, setting or dataset name", path)
    _require_measured_here(result, sources, path)
    if result.protocol.task == "safety":
        if sources is None or sources.submission is not None or sources.hidden is not None:
            raise RefusedError(
                "figures of rollouts are taken from their state logs",
                file=path,
                expected="the folder of the rollouts",
                remedy="mirror leaderboard add RESULT ROLLOUTS, without --submission and --hidden",
            )
        run = _require_run_here(result, sources, path)
        result = rescore_rollouts(result, path, Path(sources.dataset), sources.plan, progress, secret=sources.secret)
        entry = make_entry(result, dataset, file=path, setting=setting)
        entry = entry.model_copy(update={"verified": sources.plan is not None, "policy_run": run})
    elif sources is not None and sources.plan is not None:
        raise UsageError(
            f"the result is one of the protocol {result.protocol.name}",
            file=path,
            place="--street, --scenarios",
            expected="a result of the protocol safety",
        )
    elif sources is not None and sources.submission is not None:
        result = rescore(result, path, sources, progress)
        entry = make_entry(result, dataset, file=path, setting=setting)
        # Of the costs, only what was measured here is more than the submission's word; regions that another extractor
        # finds do not follow from the renders alone.
        is_runtime = result.protocol.task == "runtime"
        is_verified = sources.measured is not None if is_runtime else sources.extractor in (None, DEFAULT_EXTRACTOR)
        entry = entry.model_copy(update={"verified": is_verified})
    else:
        require_recomputed_means(result, path)
        if sources is not None:
            require_plan(result, path, sources.dataset)
    for other in load_entries(board / "entries") if (board / "entries").exists() else ():
        _require_distinct_name(entry, other, path)
        if isinstance(other, Measured):
            _require_new(entry, other, path)
    try:
        # Before the images: an interrupted run leaves a folder that is recognised as a board.
        (board / "entries").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable_error(board / "entries", error) from error
    if entry.verified and sources is not None and result.protocol.task == "reconstruction":
        pairs = copy_pairs(result, sources, board / IMAGE_FOLDER)
        entry = entry.model_copy(update={"pairs": pairs})
    entry = entry.model_copy(update={"added": day or today()}).sealed()
    out = board / "entries" / f"measured-{_slug(entry.dataset)}-{_slug(entry.method)}-{entry.result_hash[:12]}.json"
    write_json(out, entry)
    return out


def _require_run_here(result: Result, sources: Sources, path: Path) -> Isolation | None:
    """Return how the organiser ran the policy; None: the participant did.

    Raises:
        RefusedError: the drives are not those of a sandbox or a container, or the suite ranks only such.
    """
    suite = result.protocol.suite
    if not sources.ran_here:
        if suite is not None and suite.is_secret:
            raise RefusedError(
                "driven controls do not show that a policy saw the images", file=path, place="--ran-here",
                expected="a policy that the organiser ran",
                remedy="run the policy yourself, in a sandbox or a container, and give --ran-here",
            )  # fmt: skip
        return None
    file = Path(sources.dataset) / SUITE_FILE
    run = read_json(file, SuiteRun) if file.is_file() else None
    if run is None or run.isolation is None or run.protocol_hash != result.protocol_hash:
        raise RefusedError(
            "no drives of this suite with a policy that ran apart", file=file, place="isolation",
            expected="a folder of `mirror simulate --suite` with --policy sandbox:COMMAND or container:IMAGE",
            remedy="leave --ran-here out",
        )  # fmt: skip
    return run.isolation


def read_result(path: Path) -> Result:
    """Read a result and verify its hashes.

    Raises:
        DatasetError: the file cannot be read.
        RefusedError: the document is not a result, or its parts contradict each other.
        UntrustedError: the file is too large, or is not JSON.
    """
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}", file=path, expected="a result.json") from error
    raw = parse_untrusted(data, str(path), _MAX_BYTES)
    try:
        result = Result.model_validate(raw)
    except ValidationError as error:
        first = error.errors()[0]
        raise RefusedError(
            describe_problem_and_value(first),
            file=path,
            place=".".join(str(part) for part in first["loc"]) or "the whole document",
            expected="a result.json of `mirror evaluate`",
        ) from error
    _require_consistent(result, path)
    return result


def make_entry(result: Result, dataset: str, *, file: Path, setting: str | None = None) -> Measured:
    """Make the entry of a result.

    Raises:
        RefusedError: the protocol is unknown or has another version, or a figure is unknown or impossible.
    """
    _require_protocol(result, file)
    method, runtime = result.submission.method, result.submission.runtime
    try:
        entry = Measured(
            method=method.name,
            version=method.version,
            link=_valid_link(method.url),
            protocol=result.protocol.name,
            protocol_version=result.protocol.version,
            protocol_hash=result.protocol_hash,
            dataset=dataset,
            dataset_hash=result.dataset.dataset_hash,
            plan_hash=result.dataset.plan_hash,
            split=result.dataset.split,
            options=_list_options(result),
            setting=setting,
            result_hash=result.hash,
            toolkit=result.versions.get("mirror", __version__),
            frames_per_second=None if runtime is None else runtime.frames_per_second,
            device=None if runtime is None else runtime.device,
            figures=tuple(_make_figures(result, file)),
            clusters=tuple(Cluster.model_validate(one.model_dump()) for one in result.clusters),
            notes=tuple(_to_plain_line(note) for note in result.warnings),
        )
    except ValidationError as error:
        first = error.errors()[0]
        raise RefusedError(
            describe_problem(first), file=file, place=".".join(map(str, first["loc"])), expected="a valid entry"
        ) from error
    if all(figure.value is None for figure in entry.figures):
        raise RefusedError("has no figure with a value", file=file, place="figures", expected="a scored submission")
    return entry.sealed()


def _require_consistent(result: Result, file: Path) -> None:
    """Compare the values that a result states twice."""
    submission = result.submission
    pairs = {
        "protocol_hash": (result.protocol_hash, result.protocol.hash, "the hash of the result's protocol"),
        "submission.protocol": (submission.protocol, result.protocol.name, "the result's protocol"),
        "submission.protocol_hash": (submission.protocol_hash, result.protocol_hash, "the result's"),
        "submission.dataset_hash": (submission.dataset_hash, result.dataset.dataset_hash, "the result's"),
        "submission.plan_hash": (submission.plan_hash, result.dataset.plan_hash, "the result's"),
        "submission.split": (submission.split, result.dataset.split, "the result's"),
    }
    for place, (stated, expected, source) in pairs.items():
        if stated != expected:
            raise RefusedError(
                f"{stated!r} is not {source}: the result was put together or changed by hand",
                file=file,
                place=place,
                expected=expected,
                remedy="evaluate the submission again: mirror evaluate",
            )


def _require_protocol(result: Result, file: Path) -> None:
    name, known = result.protocol.name, protocol_names()
    if name not in known:
        raise RefusedError(
            f"unknown protocol {name!r}", file=file, place="protocol.name", expected=f"one of {', '.join(known)}"
        )
    current = load_protocol(name)
    commitment = _find_commitment(result)
    if commitment is not None and current.suite is not None and current.suite.draw is not None:
        current = commit_to_secret(current, commitment)
    if current.hash != result.protocol_hash:
        raise RefusedError(
            f"protocol {name} version {result.protocol.version} is not the board's version {current.version}",
            file=file,
            place="protocol_hash",
            expected=current.hash,
            remedy="evaluate the submission again with this version of the toolkit",
        )


def _find_commitment(result: Result) -> str | None:
    suite = result.protocol.suite
    return None if suite is None or suite.draw is None else suite.draw.commitment


def _make_figures(result: Result, file: Path) -> Iterator[Figure]:
    groups = _list_groups(result)
    for number, figure in enumerate(result.figures):
        if figure.level != "group":
            continue
        place = f"figures.{number}"
        try:
            measure = find_measure(figure.metric)
        except UsageError as error:
            raise RefusedError(error.problem, file=file, place=place) from error
        if not measure.is_listed:
            continue
        if figure.group not in (*groups, ALL):
            raise RefusedError(
                f"the protocol has no group {figure.group!r}",
                file=file,
                place=place,
                remedy="evaluate the submission again",
            )
        if figure.better != measure.better:
            raise RefusedError(
                f"{figure.metric} is stated to be better {figure.better}",
                file=file,
                place=place,
                remedy="evaluate the submission again",
            )
        try:
            yield Figure(
                group=figure.group,
                metric=figure.metric,
                value=figure.value,
                low=figure.low if figure.high is not None else None,
                high=figure.high if figure.low is not None else None,
                n=figure.n,
                n_missing=figure.n_missing,
                n_infinite=figure.n_inf,
                note=_to_plain_line("; ".join(_list_remarks(figure))) or None,
            )
        except ValidationError as error:
            raise RefusedError(
                describe_problem(error.errors()[0]), file=file, place=place, remedy="evaluate the submission again"
            ) from error
    for metric, reason in result.unavailable.items():
        note = _to_plain_line(f"unavailable: {reason.partition('; ')[0]}")
        for group in groups[: 1 if result.protocol.task == "runtime" else None]:
            yield Figure(group=group, metric=metric, value=None, note=note)


def _list_remarks(figure: GroupFigure) -> Iterator[str]:
    """List the note of a figure, and the reasons why it has no value or no interval."""
    if figure.reason or figure.note:
        yield figure.reason or figure.note or ""
    if figure.value is not None and figure.low is None and figure.interval_reason:
        yield f"no interval: {figure.interval_reason}"


def _list_options(result: Result) -> dict[str, str]:
    hidden = result.dataset.hidden_truth
    fitted = {"appearance": "fitted"} if result.submission.appearance.policy == "fitted" else {}
    commitment = _find_commitment(result)
    split = {} if commitment is None else {COMMITMENT: commitment}
    return {**result.options, **fitted, **split, **({} if hidden is None else {"hidden truth": hidden[:12]})}


def _list_groups(result: Result) -> tuple[str, ...]:
    """List the groups that can have figures."""
    if result.protocol.task == "runtime":
        return _RUNTIME_GROUPS
    return tuple(group.name for group in result.protocol.groups if not group.without_vehicles)


def _require_name(name: str, place: str, file: Path) -> None:
    problem = find_name_problem(name)
    if problem is not None:
        raise RefusedError(f"{name!r} {problem}", file=file, place=place, expected="a plain name")


def _require_distinct_name(entry: Measured, other: Entry, file: Path) -> None:
    """Refuse a name that a reader takes for another method's."""
    if other.method != entry.method and skeleton(other.method) == skeleton(entry.method):
        raise RefusedError(
            f"{entry.method!r} is easily taken for {other.method!r}, which is on the board",
            file=file,
            place="submission.method.name",
            remedy="write it as on the board, or choose another name",
        )


def _require_measured_here(result: Result, sources: Sources | None, file: Path) -> None:
    """Refuse costs that the result says were measured, unless they are measured again now."""
    is_measured = sources is not None and sources.measured is not None
    if is_measured and result.protocol.task != "runtime":
        raise UsageError(
            f"the result is one of the protocol {result.protocol.name}",
            file=file,
            place="--measure",
            expected="a result of the protocol runtime",
        )
    if not is_measured and any(figure.group == MEASURED_HERE for figure in result.figures):
        raise RefusedError(
            "says that a speed was measured, which was not done here",
            file=file,
            place="figures",
            expected="stated figures alone",
            remedy="measure it here, with --submission and --measure METHOD=MODEL, or evaluate without --measure",
        )


def _require_new(entry: Measured, other: Measured, file: Path) -> None:
    if other.result_hash == entry.result_hash:
        raise RefusedError(
            f"result {entry.result_hash[:12]} of {entry.method} is on the board already",
            file=file,
            place="figures",
            remedy="nothing is left to do; another --setting names another row",
        )
    if entry_key(other) == entry_key(entry):
        raise RefusedError(
            f"{entry.method} {entry.version} is on the board already, for this protocol, dataset and split",
            file=file,
            place="submission.method",
            remedy="give another version in the manifest, distinguish it with --setting, or remove the old entry",
        )


def _valid_link(url: str) -> str | None:
    try:
        return _LINK.validate_python(url)
    except ValidationError:
        return None


def _to_plain_line(text: str) -> str:
    """Return the text as one line without control characters, cut to the length limit of a note."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())[:_MAX_NOTE_CHARACTERS]


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:40] or "x"
