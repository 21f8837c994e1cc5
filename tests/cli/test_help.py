"""The help of every verb: groups, metavars, defaults, the place of the dataset, and examples that parse."""

from __future__ import annotations

import io
import re
import shlex
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import NoReturn

import pytest

from mirror import command_line
from mirror.cli.main import main
from mirror.cli.verbs import HEADINGS, all_commands

DATASET_FIRST = (
    "align",
    "annotate",
    "baseline",
    "calibrate check",
    "calibrate refine",
    "check",
    "dataset gc",
    "dataset migrate",
    "dataset publish",
    "dataset take-down",
    "deidentify",
    "depth",
    "evaluate",
    "export colmap",
    "export gsplat",
    "export kitti",
    "export lerobot",
    "export webdataset",
    "export ncore",
    "export nerfstudio",
    "export nuscenes",
    "export-ply",
    "generate clips",
    "generate scene",
    "index",
    "plot",
    "reconstruct",
    "release build",
    "release review",
    "render",
    "report",
    "split",
    "sql",
    "stats",
    "submission check",
    "submission hidden",
    "submission new",
    "view",
)
"""Commands that read a dataset: its place is the first argument."""


def printed_help(command: str) -> str:
    """Return what ``mirror COMMAND --help`` prints."""
    # The frames of the help need an encoding that has them.
    output = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", newline="\n")
    with redirect_stdout(output):
        try:
            main([*command.split(), "--help"])
        except SystemExit as ended:
            assert ended.code == 0
    output.seek(0)
    return output.read()


def all_command_names() -> list[str]:
    """Every verb; of a verb with subcommands, these."""
    names = []
    for verb in all_commands():
        subcommands = re.match(rf"usage: mirror {verb} ([a-z-]+(?:\|[a-z-]+)*) \[options\]", printed_help(verb))
        names += [f"{verb} {name}" for name in subcommands[1].split("|")] if subcommands else [verb]
    return names


@pytest.fixture(scope="module")
def helps() -> dict[str, str]:
    return {name: printed_help(name) for name in all_command_names()}


class ParsedError(BaseException):
    """The arguments of a command were accepted; no handler of errors takes it for one of a verb or a plug-in."""


@pytest.fixture
def parses(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], bool]:
    """Return whether a command line has valid arguments; the verb itself does not run."""

    def stop(arguments: object) -> NoReturn:
        raise ParsedError

    monkeypatch.setattr(command_line, "refuse_urls", stop)

    def parse(line: str) -> bool:
        program, *words = shlex.split(line)
        assert program == "mirror"
        try:
            main(words)
        except ParsedError:
            return True
        except SystemExit:
            pass
        return False

    return parse


def test_verbs_are_in_groups() -> None:
    blocks = printed_help("").split("\n\n")
    for group, heading in HEADINGS.items():
        (block,) = [block for block in blocks if block.startswith(f"{heading}:\n")]
        listed = [line.split()[0] for line in block.splitlines()[1:]]
        assert listed == [verb for verb, command in all_commands().items() if command.group == group]
    assert set(HEADINGS) == {"data", "benchmark", "reconstruction"}


def test_subcommands_are_found() -> None:
    names = all_command_names()
    assert {"rois propose", "submission new", "leaderboard add"} <= set(names)
    assert len(names) > len(all_commands())


def test_help_names_types_and_defaults_plainly(helps: dict[str, str]) -> None:
    for name, text in helps.items():
        assert text.startswith(f"usage: mirror {name} "), name
        assert "{None" not in text, name
        assert "(default: None)" not in text, name
        # An empty default is none.
        assert not re.search(r"\(default:\s*\)", text), name


def test_every_option_has_a_default_or_is_required(helps: dict[str, str]) -> None:
    for name, text in helps.items():
        _, *options = re.split(r"\n│ (?=\S)", text)
        assert len(options) > 1, name
        for option in options:
            words = " ".join(line.strip("│╭╰─╮╯ ") for line in option.splitlines())
            if words.startswith("--"):
                assert re.search(r"\((default: .+|required|repeatable)\)", words), (name, words)


def test_the_dataset_is_the_first_argument_of_each_verb_that_reads_one(helps: dict[str, str]) -> None:
    for name, text in helps.items():
        first = re.search(r"positional arguments ─+╮\n│ (\S+)", text)
        assert (first is not None and first[1] == "DATASET") == (name in DATASET_FIRST), name
        # --dataset-name is the name of a row of the leaderboard.
        assert not re.search(r"--dataset(?!-name)", text), name
    assert set(DATASET_FIRST) < set(helps)
    assert "RESULT DATASET" in helps["leaderboard add"]
    assert "DATASET|RECORDING" in helps["info"]


def test_each_help_ends_with_two_examples_that_parse(helps: dict[str, str], parses: Callable[[str], bool]) -> None:
    for name, text in helps.items():
        examples = text.partition("\nexamples, ")[2].splitlines()[1:]
        assert len(examples) == 2, name
        for line in examples:
            assert line.startswith(f"  mirror {name}"), line
            assert parses(line), line


def test_wrong_examples_would_be_noticed(parses: Callable[[str], bool], capsys: pytest.CaptureFixture[str]) -> None:
    assert parses("mirror check demo/dataset")
    assert not parses("mirror check demo/dataset --no-such-option")
    assert not parses("mirror check")


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("check d --quick --full", "--quick and --full exclude each other"),
        ("reconstruct d --split s --out m --minutes 1 --steps 2", "--minutes and --steps exclude each other"),
        ("render d m --out o --split s --trajectory lane-shift:1", "--split and --trajectory exclude each other"),
        ("render d m --out o", "neither --split nor --trajectory was given"),
        ("split d s --extend --seed 1", "--extend and --seed exclude each other"),
    ],
)
def test_exclusive_options_are_both_named(words: str, problem: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words.split()) == 2
    assert problem in capsys.readouterr().err
