"""Remedies name options and verbs that exist, and calls only where no verb leads."""

from __future__ import annotations

import ast
import io
import re
from collections.abc import Iterator
from contextlib import redirect_stdout, suppress
from functools import cache
from pathlib import Path
from typing import Final

from mirror.cli.main import main
from mirror.cli.verbs import all_commands

ROOT: Final = Path(__file__).parents[1]
FILLED: Final = "\0"
"""Stands for what a message fills in."""

OF_OTHER_PROGRAMS: Final = {
    "mirror/weights/wheels.py": {"--no-deps", "--dest"},
    "baselines/hybridworldsim/generation/training/processes.py": {"--nproc-per-node"},
    "baselines/hybridworldsim/generation/clips/folder.py": {"--out"},
    "baselines/hybridworldsim/generation/training/windows.py": {"--map"},
}
"""Options of pip, torchrun and `python -m benchmarks`."""

ONLY_FROM_PYTHON: Final = {
    "mirror/geometry/poses.py",
    "mirror/dataset/samples.py",
    "mirror/dataset/torch.py",
    "mirror/metrics/inputs.py",
    "baselines/hybridworldsim/rasterizer/inputs.py",
    "baselines/hybridworldsim/rasterizer/rasterization.py",
    "baselines/hybridworldsim/rasterizer/cpu/blending/blend.py",
    "baselines/hybridworldsim/rasterizer/cuda.py",
    "baselines/hybridworldsim/simulator/environment/street_env.py",
}
"""Modules whose errors reach programs that import the toolkit: no verb gives them arguments of its user."""

RAISED_BY: Final = {
    "mirror/ingest/": ("ingest",),
    "mirror/recordings/": ("ingest", "info", "recording new"),
    "mirror/privacy/": ("deidentify", "release build", "release check", "release review", "release withdraw"),
    "mirror/export/": ("export colmap", "dataset publish", "dataset fetch", "dataset audit"),
    "mirror/annotation/": ("annotate", "annotate track", "annotate train", "annotate masks", "annotate export"),
    "mirror/calibration/": ("calibrate check", "calibrate refine", "calibrate intrinsics"),
    "mirror/synth/": ("synth", "submission hidden"),
    "mirror/dataset/splits/": ("split",),
    "mirror/evaluation/": ("evaluate",),
    "mirror/view/": ("view", "plot", "report", "stats"),
    "mirror/weights/": ("weights fetch", "weights list"),
    "baselines/hybridworldsim/generation/": ("generate train", "generate distil", "generate scene"),
    "baselines/hybridworldsim/petr/": ("annotate", "annotate train"),
    "baselines/hybridworldsim/simulator/": ("simulate", "serve"),
    "baselines/hybridworldsim/methods/": ("reconstruct", "render"),
    "baselines/hybridworldsim/model/": ("reconstruct", "render"),
    "baselines/hybridworldsim/mvs/": ("depth", "reconstruct"),
    "baselines/hybridworldsim/training/": ("reconstruct", "generate train", "annotate train"),
    "leaderboard/": ("leaderboard add", "leaderboard build", "leaderboard sign"),
}
"""Verbs that can raise the errors of a folder."""

_CALL: Final = re.compile(r"(?<![\w])[a-z_]+(?:\.[a-z_]+)*\((?!s\))|\b[a-z_]+=(?:[\[\"']|\.\.\.|True|False|None)")


def remedies() -> Iterator[tuple[str, str, str]]:
    """File, place and text of each remedy of the source, with `FILLED` where something is filled in."""
    for folder in ("mirror", "baselines", "leaderboard"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            name = file.relative_to(ROOT).as_posix()
            source = file.read_text()
            if "remedy" not in source:
                continue
            for node in ast.walk(ast.parse(source)):
                if isinstance(node, ast.keyword) and node.arg == "remedy":
                    for text in _texts(node.value):
                        yield name, f"{name}:{node.value.lineno}", text


def _texts(node: ast.expr) -> Iterator[str]:
    """The texts of an expression; those of its branches are several."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        yield "".join(str(part.value) if isinstance(part, ast.Constant) else FILLED for part in node.values)
    elif isinstance(node, ast.IfExp):
        yield from _texts(node.body)
        yield from _texts(node.orelse)
    elif isinstance(node, ast.BinOp):
        for left in _texts(node.left):
            for right in _texts(node.right):
                yield left + right


@cache
def help_of(words: str) -> str:
    said = io.StringIO()
    with redirect_stdout(said), suppress(SystemExit):
        main([*words.split(), "--help"])
    assert said.getvalue().startswith("usage: "), words
    return said.getvalue()


@cache
def subcommands(verb: str) -> tuple[str, ...]:
    """The subcommands of a verb that has some, as its help lists or names them."""
    text = help_of(verb)
    usage = re.match(rf"usage: mirror {re.escape(verb)} ([a-z-]+(?:\|[a-z-]+)*) \[options\]", text)
    listed = usage.group(1).split("|") if usage else []
    flat = re.sub(r"[\s│]+", " ", text)
    named = re.findall(rf"`mirror {re.escape(verb)} ([a-z]+)`", flat)
    return tuple(dict.fromkeys([*listed, *(name for name in named if not usage)]))


@cache
def options_of(words: str) -> frozenset[str]:
    return frozenset(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", help_of(words)))


def is_pure_group(verb: str) -> bool:
    return help_of(verb).partition("\n")[0].endswith(" [options]") and "[-h]" not in help_of(verb).partition("\n")[0]


@cache
def all_options() -> frozenset[str]:
    found: set[str] = set()
    for verb in all_commands():
        for words in (verb, *(f"{verb} {name}" for name in subcommands(verb))):
            found |= options_of(words)
    return frozenset(found)


def commands_in(text: str) -> Iterator[tuple[str, list[str]]]:
    """The words and the options of each command that a text names."""
    for found in re.finditer(r"\bmirror ([a-z][a-z-]*)((?: [^`;,()]*)?)", text):
        yield found.group(1), found.group(2).split()


def test_options_of_remedies_exist_in_the_verb_that_they_name() -> None:
    wrong, count = [], 0
    for name, place, text in remedies():
        own = OF_OTHER_PROGRAMS.get(name, set())
        stated = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", text)) - own
        count += len(stated)
        for verb, words in commands_in(text):
            if verb not in all_commands():
                wrong.append(f"{place}: no verb {verb}: {text}")
                continue
            command = verb
            if subcommands(verb) and words and re.fullmatch("[a-z-]+", words[0]):
                if words[0] in subcommands(verb):
                    command = f"{verb} {words[0]}"
                elif is_pure_group(verb):
                    wrong.append(f"{place}: mirror {verb} has no {words[0]}: {text}")
            of_command = {word.split("=")[0].rstrip(".:") for word in words if word.startswith("--")} - own
            if of_command - options_of(command):
                wrong.append(f"{place}: mirror {command} has no {sorted(of_command - options_of(command))}: {text}")
        if stated - all_options():
            wrong.append(f"{place}: no verb has {sorted(stated - all_options())}: {text}")
    assert wrong == []
    assert count > 100


def test_options_without_a_verb_are_those_of_a_verb_that_can_raise_the_error() -> None:
    wrong, count = [], 0
    for name, place, text in remedies():
        stated = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", text)) - OF_OTHER_PROGRAMS.get(name, set())
        verbs = next((verbs for folder, verbs in RAISED_BY.items() if name.startswith(folder)), None)
        if stated and verbs and not list(commands_in(text)):
            count += 1
            if not any(stated <= options_of(verb) for verb in verbs):
                wrong.append(f"{place}: none of {verbs} has {sorted(stated)}: {text}")
    assert wrong == []
    assert count > 50


def test_remedies_have_no_call_where_a_verb_leads() -> None:
    calls = [
        f"{place}: {text}" for name, place, text in remedies() if name not in ONLY_FROM_PYTHON and _CALL.search(text)
    ]
    assert calls == []


def test_the_modules_that_are_listed_have_calls() -> None:
    found = {name for name, _, text in remedies() if _CALL.search(text)}
    assert found >= ONLY_FROM_PYTHON
