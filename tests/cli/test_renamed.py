"""Old names of verbs and options are accepted, with a note that names the new one."""

from __future__ import annotations

from typing import NoReturn

import pytest

from mirror import command_line
from mirror.cli.main import main
from mirror.cli.verbs import RENAMED, all_commands
from mirror.command_line import apply_new_names
from mirror.errors import ExitCode

MISSING = "no-such-folder"


@pytest.mark.parametrize(
    ("words", "note"),
    [
        (
            ["split", MISSING, "novel", "--held-out", "2"],
            "mirror split: --held-out is now called --held-out-traversals",
        ),
        (["split", MISSING, "novel", "--held_out=2"], "mirror split: --held-out is now called --held-out-traversals"),
        (["reconstruct", MISSING, "--split", "s", "--out", "m", "--half"], "--half is now called --fp16"),
        (["reconstruct", MISSING, "--split", "s", "--out", "m", "--no-half"], "--no-half is now called --no-fp16"),
    ],
)
def test_an_old_option_is_accepted_with_a_note(words: list[str], note: str, capsys: pytest.CaptureFixture[str]) -> None:
    # The folder is missing, which is noticed after the arguments were accepted.
    assert main(words) == ExitCode.COULD_NOT_RUN
    error = capsys.readouterr().err
    assert note in error
    assert MISSING in error.splitlines()[-1]


@pytest.mark.parametrize(("verb", "option"), [("split", "--held-out "), ("reconstruct", "--half")])
def test_help_shows_the_new_name_alone(verb: str, option: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([verb, "--help"])
    assert option not in capsys.readouterr().out


@pytest.mark.parametrize("old", RENAMED)
def test_an_old_verb_is_accepted_with_a_note(old: str, capsys: pytest.CaptureFixture[str]) -> None:
    new = RENAMED[old]
    assert old not in all_commands() and new in all_commands()
    with pytest.raises(SystemExit) as ended:
        main([old, "--help"])
    assert ended.value.code == ExitCode.DONE
    printed = capsys.readouterr()
    assert printed.err == f"mirror: the verb {old} is now called {new}\n"
    assert f"mirror {new}" in printed.out


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("evaluate S --truth D --workers 1", "evaluate D S --workers 1"),
        ("evaluate --truth=D S", "evaluate D S"),
        ("submission check S --truth D", "submission check D S"),
        ("render A B --dataset D --split s --out o", "render D A B --split s --out o"),
        ("export-ply M --dataset D --out x.ply", "export-ply D M --out x.ply"),
        ("baseline mean_color D --split s --out o", "baseline D --method mean_color --split s --out o"),
        (
            "leaderboard add --truth D R --dataset n --submission S",
            "leaderboard add R D --dataset-name n --submission S",
        ),
        ("ingest R --max-gap 3 --dry-run", "ingest R --max-gap-s 3 --dry-run"),
        ("split D n --held-out 2", "split D n --held-out-traversals 2"),
    ],
)
def test_old_words_give_the_same_arguments(
    old: str, new: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class ParsedError(Exception):
        """Has the arguments that were parsed."""

    def stop(arguments: object) -> NoReturn:
        raise ParsedError(arguments)

    monkeypatch.setattr(command_line, "refuse_urls", stop)
    results = []
    for words in (old, new):
        with pytest.raises(ParsedError) as ended:
            main(words.split())
        results.append((ended.value.args[0], capsys.readouterr().err))
    (old_arguments, note), (new_arguments, nothing) = results
    assert old_arguments == new_arguments
    assert " is now " in note and nothing == ""


def test_values_are_not_renamed(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--name", "half", "-half", "--halfway", "--out=--half"]
    assert apply_new_names(words, "mirror x", {"--half": "--fp16"}) == words
    assert capsys.readouterr().err == ""
