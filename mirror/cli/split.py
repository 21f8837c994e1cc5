"""``mirror split DATASET NAME``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.counting import count_of
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.dataset.splits import SplitReport
    from mirror.schema.documents import LightAndWeather, SplitMethod


@dataclass(frozen=True)
class Arguments:
    """Divide the traversals of a dataset into roles, without a leak, and freeze the result in splits/NAME.json.

    Methods: novel-traversal holds out --held-out-traversals of each scene and trains on --train others (the paper: 1
    and 4). by-scene divides whole scenes into train, val and test by shares. by-condition tests on the traversals that
    match --test-on and trains on the others that match --train-on. by-list holds out the traversals that --held-out-id
    names, as a published split has them. An existing split stays unchanged, also when the dataset has grown.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    name: tyro.conf.Positional[str]
    """Name of the split."""
    method: Annotated[
        Literal["novel-traversal", "by-scene", "by-condition", "by-list"] | None, help_text(default="novel-traversal")
    ] = None
    """Method of division."""
    train: Annotated[float | None, help_text(default="4; by-scene: 0.7")] = None
    """Training traversals per scene. With by-scene, the share of scenes."""
    held_out_traversals: Annotated[int | None, help_text(default="1")] = None
    """Traversals per scene to hold out (novel-traversal)."""
    val: Annotated[float | None, help_text(default="0.15")] = None
    """Share of scenes for validation (by-scene)."""
    test: Annotated[float | None, help_text(default="0.15")] = None
    """Share of scenes for the test (by-scene)."""
    train_on: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="KEY=VALUE,...")] = ()
    """Condition of training traversals (by-condition), such as light=day or light=day,weather=clear."""
    test_on: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="KEY=VALUE,...")] = ()
    """Condition of test traversals (by-condition), such as light=night."""
    held_out_id: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="ID")] = ()
    """Traversal to hold out (by-list)."""
    train_id: Annotated[
        tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="ID", default="all others of these scenes")
    ] = ()
    """Traversal to train on (by-list)."""
    seed: Annotated[int | None, help_text(default="0")] = None
    """Seed of the random choice."""
    scene: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="ID")] = ()
    """Divide only this scene."""
    require: bool = False
    """Fail if a scene has too few traversals. Without it the scene is left out and listed."""
    extend: bool = False
    """Add the traversals that came after the split to train. Excludes the options that define a split."""
    replace: bool = False
    """Replace an existing split."""
    wait: bool = False
    """Wait until no other run writes the dataset. Without it, a dataset that is being written is an error."""
    json: bool = False
    """Print the report as JSON."""


_OPTIONS_BY_METHOD = {
    "novel-traversal": ("train", "held_out_traversals"),
    "by-scene": ("train", "val", "test"),
    "by-condition": ("train_on", "test_on"),
    "by-list": ("held_out_id", "train_id"),
}
_RENAMED = {"--held-out": "--held-out-traversals"}
_EXAMPLES = (
    "mirror split demo/dataset more --train 3 --held-out-traversals 2 --replace",
    "mirror split demo/dataset night --method by-condition --train-on light=day --test-on light=night",
)


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror split", examples=_EXAMPLES, renamed=_RENAMED)

    from mirror.dataset.splits import extend_split, make_split

    if arguments.extend:
        _refuse_beside_extend(arguments)
        report = extend_split(arguments.dataset, arguments.name, wait=arguments.wait)
    else:
        report = make_split(
            arguments.dataset,
            arguments.name,
            _parameters(arguments),
            seed=arguments.seed or 0,
            scenes=arguments.scene or None,
            require=arguments.require,
            replace=arguments.replace,
            wait=arguments.wait,
        )
    if arguments.json:
        print(json.dumps(_plain(report, arguments)))
    else:
        _print(report, arguments)
    return ExitCode.DONE


def _refuse_beside_extend(arguments: Arguments) -> None:
    names = (
        "method",
        "train",
        "held_out_traversals",
        "val",
        "test",
        "train_on",
        "test_on",
        "held_out_id",
        "train_id",
        "seed",
        "scene",
        "require",
        "replace",
    )
    given = [name for name in names if getattr(arguments, name) not in (None, (), False)]
    if given:
        raise UsageError(
            f"--extend and --{given[0].replace('_', '-')} exclude each other",
            expected="--extend without options that define a split: it keeps its method and its seed",
        )


def _parameters(arguments: Arguments) -> SplitMethod:
    from pydantic import ValidationError

    from mirror.schema.documents import ByCondition, ByList, ByScene, NovelTraversal
    from mirror.schema.problems import describe_expected, describe_problem

    method = arguments.method or "novel-traversal"
    options = {name: getattr(arguments, name) for names in _OPTIONS_BY_METHOD.values() for name in names}
    given = {name: value for name, value in options.items() if value not in (None, ())}
    unsuitable = sorted(set(given) - set(_OPTIONS_BY_METHOD[method]))
    if unsuitable:
        known = ", ".join(f"--{name.replace('_', '-')}" for name in _OPTIONS_BY_METHOD[method])
        raise UsageError(
            f"--{unsuitable[0].replace('_', '-')} is not for --method {method}", expected=f"some of {known}"
        )
    try:
        if method == "by-condition":
            return ByCondition(train=_conditions("train-on", arguments), test=_conditions("test-on", arguments))
        if method == "by-list":
            if not arguments.held_out_id:
                raise UsageError("no traversal given", place="--held-out-id", expected="at least one id")
            return ByList(held_out=arguments.held_out_id, train=arguments.train_id or None)
        if method == "by-scene":
            return ByScene(**given)
        # The document's own name of the number.
        return NovelTraversal(**{"held_out" if name == "held_out_traversals" else name: n for name, n in given.items()})
    except ValidationError as error:
        first = error.errors()[0]
        if not first["loc"]:
            shares = ", ".join(f"--{name}" for name in _OPTIONS_BY_METHOD[method])
            raise UsageError(describe_problem(first), place=shares) from error
        flags = (f"--{str(part).replace('_', '-')}" for part in first["loc"][:1])
        place = "".join(_RENAMED.get(option, option) for option in flags) or None
        raise UsageError(f"{first['input']!r}", place=place, expected=describe_expected(first)) from error


def _conditions(option: str, arguments: Arguments) -> tuple[LightAndWeather, ...]:
    from typing import get_args

    from mirror.schema.documents import Light, LightAndWeather, Weather

    known = {"light": get_args(Light), "weather": get_args(Weather)}
    conditions = []
    for text in getattr(arguments, option.replace("-", "_")):
        pairs = dict(pair.partition("=")[::2] for pair in text.split(","))
        for key, value in pairs.items():
            if value not in known.get(key, ()):
                listed = "; ".join(f"{name}={'|'.join(values)}" for name, values in known.items())
                raise UsageError(f"{text!r} is not a condition", place=f"--{option}", expected=listed)
        conditions.append(LightAndWeather.model_validate(pairs))
    if not conditions:
        raise UsageError(
            "no condition given", place=f"--{option}", expected="at least one, such as light=day or weather=rain"
        )
    return tuple(conditions)


def _plain(report: SplitReport, arguments: Arguments) -> dict[str, object]:
    return {
        "dataset": str(arguments.dataset),
        "action": report.action,
        "roles": report.roles(),
        "outside": report.outside,
        "changed": report.changed,
        "split": report.document.model_dump(mode="json"),
    }


def _print(report: SplitReport, arguments: Arguments) -> None:
    document = report.document
    actions = {
        "made": "made",
        "kept": "exists already and is unchanged",
        "extended": "extended: new traversals are in train",
    }
    print(f"split {document.name} {actions[report.action]}: {arguments.dataset}/splits/{document.name}.json")
    print(f"method {document.parameters.method}, seed {document.seed}")
    print(", ".join(f"{role} {count}" for role, count in sorted(report.roles().items())))
    for place, reason in document.left_out.items():
        print(f"left out: {place}: {reason}")
    if report.outside:
        print(
            f"{count_of(len(report.outside), 'traversal')} came after the split, such as {report.outside[0]}:"
            " add them to train with --extend"
        )
    if report.changed:
        changed = count_of(len(report.changed), "traversal")
        print(
            f"warning: changed since the split: {changed}, such as {report.changed[0]}:"
            " replace the split with --replace"
        )
