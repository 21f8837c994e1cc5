"""``mirror split DATASET NAME``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mirror.dataset.splits import SplitReport
    from mirror.schema.documents import Condition, SplitMethod


@dataclass(frozen=True)
class Arguments:
    """Divide the traversals of a dataset into roles, without a leak, and freeze the result in splits/NAME.json.

    Methods: novel-traversal holds out --held-out-traversals of each scene and trains on --train others (the paper: 1
    and 4). by-scene divides whole scenes into train, val and test by shares. by-condition tests on the traversals that
    match --test-on and trains on the others that match --train-on. An existing split stays unchanged, also when the
    dataset has grown.
    """

    dataset: tyro.conf.Positional[Path]
    """The dataset's folder."""
    name: tyro.conf.Positional[str]
    """The split's name."""
    method: Literal["novel-traversal", "by-scene", "by-condition"] | None = None
    """How to divide (novel-traversal)."""
    train: float | None = None
    """Traversals a scene to train on (4); by-scene: share of the scenes (0.7)."""
    held_out_traversals: int | None = None
    """Traversals a scene to hold out (1)."""
    val: float | None = None
    """By-scene: share of the scenes (0.15)."""
    test: float | None = None
    """By-scene: share of the scenes (0.15)."""
    train_on: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """By-condition: what to train on, e.g. light=day or light=day,weather=clear; may be repeated."""
    test_on: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """By-condition: what to test on, e.g. light=night; may be repeated."""
    seed: int | None = None
    """What the choice is drawn by (0)."""
    scene: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Only this scene; may be repeated."""
    require: bool = False
    """A scene with too few traversals is an error. Default: it is left out, and listed."""
    extend: bool = False
    """Put the traversals that came after the split into train."""
    replace: bool = False
    """Make the split anew, even if it is there."""
    wait: bool = False
    """Wait for another run that is writing the dataset."""
    json: bool = False
    """Print the report as JSON."""


_OPTIONS_BY_METHOD = {
    "novel-traversal": ("train", "held_out_traversals"),
    "by-scene": ("train", "val", "test"),
    "by-condition": ("train_on", "test_on"),
}
_RENAMED = {"--held-out": "--held-out-traversals"}


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror split", renamed=_RENAMED)

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
        "seed",
        "scene",
        "require",
        "replace",
    )
    given = [name for name in names if getattr(arguments, name) not in (None, (), False)]
    if given:
        raise UsageError(
            f"--{given[0].replace('_', '-')} beside --extend",
            expected="--extend alone: a split keeps the method and seed that it was made with",
        )


def _parameters(arguments: Arguments) -> SplitMethod:
    from pydantic import ValidationError

    from mirror.schema.documents import ByCondition, ByScene, NovelTraversal

    method = arguments.method or "novel-traversal"
    options = {name: getattr(arguments, name) for names in _OPTIONS_BY_METHOD.values() for name in names}
    given = {name: value for name, value in options.items() if value not in (None, ())}
    foreign = sorted(set(given) - set(_OPTIONS_BY_METHOD[method]))
    if foreign:
        known = ", ".join(f"--{name.replace('_', '-')}" for name in _OPTIONS_BY_METHOD[method])
        raise UsageError(f"--{foreign[0].replace('_', '-')} is not for --method {method}", expected=f"some of {known}")
    try:
        if method == "by-condition":
            return ByCondition(train=_conditions("train-on", arguments), test=_conditions("test-on", arguments))
        if method == "by-scene":
            return ByScene(**given)
        # The document's own name of the number.
        return NovelTraversal(**{"held_out" if name == "held_out_traversals" else name: n for name, n in given.items()})
    except ValidationError as error:
        first = error.errors()[0]
        flags = (f"--{str(part).replace('_', '-')}" for part in first["loc"][:1])
        place = "".join(_RENAMED.get(option, option) for option in flags) or None
        raise UsageError(f"{first['msg']} (got {first['input']!r})", place=place) from error


def _conditions(option: str, arguments: Arguments) -> tuple[Condition, ...]:
    from typing import get_args

    from mirror.schema.documents import Condition, Light, Weather

    known = {"light": get_args(Light), "weather": get_args(Weather)}
    found = []
    for text in getattr(arguments, option.replace("-", "_")):
        pairs = dict(pair.partition("=")[::2] for pair in text.split(","))
        for key, value in pairs.items():
            if value not in known.get(key, ()):
                listed = "; ".join(f"{name}={'|'.join(values)}" for name, values in known.items())
                raise UsageError(f"{text!r} is no condition", place=f"--{option}", expected=listed)
        found.append(Condition.model_validate(pairs))
    if not found:
        raise UsageError(
            "no condition given", place=f"--{option}", expected="at least one, such as light=day or weather=rain"
        )
    return tuple(found)


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
    said = {
        "made": "made",
        "kept": "is there already and stays as it is",
        "extended": "extended: new traversals are in train",
    }
    print(f"split {document.name} {said[report.action]}: {arguments.dataset}/splits/{document.name}.json")
    print(f"method {document.parameters.method}, seed {document.seed}")
    print(", ".join(f"{role} {count}" for role, count in sorted(report.roles().items())))
    for place, reason in document.left_out.items():
        print(f"left out: {place}: {reason}")
    if report.outside:
        print(
            f"{len(report.outside)} traversals came later and are not in it, such as {report.outside[0]}:"
            " put them in train with --extend"
        )
    if report.changed:
        print(
            f"warning: {len(report.changed)} traversals are not what they were, such as {report.changed[0]}:"
            " make the split anew with --replace"
        )
