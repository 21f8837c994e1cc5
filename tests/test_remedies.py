"""Remedies and messages name commands of pip, verbs and options that exist, and calls only where no verb leads."""

from __future__ import annotations

import ast
import json
import re
import shlex
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import islice, product
from pathlib import Path
from typing import Final

import pytest

from mirror import installation
from mirror.cli.verbs import all_commands
from mirror.installation import NAME, install_command, upgrade_command
from tests.command_help import help_of, options_of
from tests.sources import parse, without_collection

ROOT: Final = Path(__file__).parents[1]
TOPS: Final = (".", "baselines", "leaderboard")
FILLED: Final = "\0"
"""Stands for what a message fills in."""

OF_OTHER_PROGRAMS: Final = {
    "mirror/installation.py": {"--upgrade"},
    "mirror/executors/ray_cluster.py": {"--head", "--num-cpus", "--num-gpus", "--resources"},
    "mirror/weights/resolve.py": {"--no-deps"},
    "mirror/weights/wheels.py": {"--no-deps", "--dest"},
    "baselines/hybridworldsim/training/run/processes.py": {"--nproc-per-node"},
    "baselines/hybridworldsim/generation/clips/folder.py": {"--out"},
    "baselines/hybridworldsim/generation/training/windows.py": {"--map"},
}
"""Options of pip, Ray, torchrun and `python -m benchmarks`."""

ONLY_FROM_PYTHON: Final = {
    "mirror/geometry/poses.py",
    "mirror/dataset/samples.py",
    "mirror/dataset/torch.py",
    "mirror/metrics/inputs.py",
    "baselines/hybridworldsim/rasterizer/inputs.py",
    "baselines/hybridworldsim/rasterizer/rasterization.py",
    "baselines/hybridworldsim/rasterizer/shutter_inputs.py",
    "baselines/hybridworldsim/rasterizer/cpu/blending/blend.py",
    "baselines/hybridworldsim/rasterizer/cuda.py",
    "baselines/hybridworldsim/simulator/environment/street_env.py",
}
"""Modules whose errors reach programs that import the toolkit: no verb gives them arguments of its user."""

RAISED_BY: Final = {
    "mirror/addresses.py": ("view", "serve"),
    "mirror/command_line.py": ("annotate", "reconstruct"),
    "mirror/executors/": ("ingest", "annotate", "deidentify", "reconstruct", "generate clips"),
    "mirror/cli/reconstruct.py": ("reconstruct",),
    "mirror/cli/compile.py": ("compile",),
    "mirror/cli/ingest.py": ("ingest", "rois propose"),
    "mirror/cli/layers.py": ("view", "reconstruct", "export colmap"),
    "mirror/cli/recording.py": ("recording new",),
    "mirror/cli/report.py": ("report",),
    "mirror/cli/submission.py": ("evaluate", "submission check"),
    "mirror/cli/view.py": ("view",),
    "mirror/devices.py": ("reconstruct", "render", "annotate"),
    "mirror/dataset/derived_layer.py": ("annotate", "annotate track", "annotate masks", "calibrate refine"),
    "mirror/dataset/door/": ("ingest", "dataset publish"),
    "mirror/dataset/images/": ("ingest",),
    "mirror/dataset/lock.py": ("ingest", "index", "split"),
    "mirror/dataset/lease.py": ("dataset gc", "dataset migrate", "dataset take-down"),
    "mirror/dataset/take_down.py": ("dataset take-down", "ingest"),
    "mirror/dataset/taken_down.py": ("dataset take-down",),
    "mirror/export/take_down.py": ("dataset take-down",),
    "mirror/integrity/": ("check", "ingest"),
    "mirror/localisation/structure/": ("poses",),
    "mirror/methods/spz.py": ("export-ply",),
    "mirror/methods/": ("reconstruct", "render"),
    "mirror/schema/render_folder.py": ("render",),
    "baselines/mirror_baselines/": ("render", "baseline"),
    "mirror/ingest/": ("ingest", "rois propose"),
    "mirror/metrics/": ("evaluate",),
    "mirror/protocols/": ("render", "evaluate", "generate scene"),
    "mirror/remedies.py": ("ingest", "rois propose"),
    "mirror/recordings/": ("ingest", "info", "recording new"),
    "mirror/privacy/": ("deidentify", "release build", "release check", "release review", "release withdraw"),
    "mirror/export/": ("export colmap", "dataset publish", "dataset fetch", "dataset audit"),
    "mirror/annotation/": ("annotate", "annotate track", "annotate train", "annotate masks", "annotate export"),
    "mirror/calibration/": ("calibrate check", "calibrate refine", "calibrate intrinsics"),
    "mirror/synth/": ("synth", "submission hidden"),
    "mirror/traffic/": ("synth", "simulate"),
    "mirror/dataset/splits/": ("split",),
    "mirror/evaluation/submission/models.py": ("render",),
    "mirror/evaluation/": ("evaluate",),
    "mirror/view/": ("view", "plot", "report", "stats"),
    "mirror/weights/": ("weights fetch", "weights list"),
    "baselines/hybridworldsim/generation/recorded/": ("generate clips",),
    "baselines/hybridworldsim/generation/": ("generate clips", "generate train", "generate distil", "generate scene"),
    "baselines/hybridworldsim/petr/": ("annotate", "annotate train"),
    "baselines/hybridworldsim/simulator/": ("simulate", "serve"),
    "baselines/hybridworldsim/methods/": ("reconstruct", "render"),
    "baselines/hybridworldsim/model/": ("reconstruct", "render"),
    "baselines/hybridworldsim/mvs/": ("depth", "reconstruct"),
    "baselines/hybridworldsim/training/appearance.py": ("render", "export-ply", "generate scene"),
    "baselines/hybridworldsim/trainable/": ("reconstruct", "render"),
    "baselines/hybridworldsim/training/": ("reconstruct", "generate train", "annotate train"),
    "leaderboard/": ("leaderboard add", "leaderboard build", "leaderboard sign"),
}
"""Verbs that can raise the errors of a folder."""

_CALL: Final = re.compile(r"(?<![\w])[a-z_]+(?:\.[a-z_]+)*\((?!s\))|\b[a-z_]+=(?:[\[\"']|\.\.\.|True|False|None)")


UNREAD: Final = 5
"""Number of remedies whose text no rule below finds. It may fall, not grow."""


class Module:
    """A module of the source: its tree, and what its names stand for."""

    def __init__(self, file: Path) -> None:
        self.name = file.relative_to(ROOT).as_posix()
        self.tree = parse(file)
        self.nodes = tuple(ast.walk(self.tree))
        self.constants = _assigned(self.tree.body)
        functions = [node for node in self.nodes if isinstance(node, ast.FunctionDef)]
        self.functions = {node.name: node for node in functions}
        self.imported = {
            name.asname or name.name: (node.module, name.name)
            for node in self.nodes
            if isinstance(node, ast.ImportFrom) and node.module
            for name in node.names
        }
        self.owner = {part: function for function in functions for part in ast.walk(function)}
        """The innermost function of each node: `ast.walk` yields outer ones first."""

    def documentation(self) -> set[ast.AST]:
        """Texts that are no message: they stand alone as statements."""
        return {node.value for node in self.nodes if isinstance(node, ast.Expr)}


def _assigned(body: Sequence[ast.AST]) -> dict[str, list[ast.expr]]:
    """The values that names are given in statements."""
    found: dict[str, list[ast.expr]] = {}
    for node in body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                pairs = [(target, node.value)]
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    pairs = list(zip(target.elts, node.value.elts))
                for one, value in pairs:
                    if isinstance(one, ast.Name):
                        found.setdefault(one.id, []).append(value)
    return found


@cache
def _assigned_in(function: ast.FunctionDef) -> dict[str, list[ast.expr]]:
    """The values that names are given in a function."""
    return _assigned(list(ast.walk(function)))


@cache
def module_at(file: Path) -> Module:
    return Module(file)


@cache
def modules() -> tuple[Module, ...]:
    files = [
        file for folder in ("mirror", "baselines", "leaderboard") for file in sorted((ROOT / folder).rglob("*.py"))
    ]
    with without_collection():
        return tuple(module_at(file) for file in files)


def _find(module: Module, name: str) -> tuple[Module, str]:
    """The module in which an imported name is defined."""
    for _ in range(4):
        if name in module.constants or name in module.functions or name not in module.imported:
            break
        source, name = module.imported[name]
        places = [ROOT / top / f"{source.replace('.', '/')}{end}" for top in TOPS for end in (".py", "/__init__.py")]
        file = next((place for place in places if place.is_file()), None)
        if file is None:
            break
        module = module_at(file)
    return module, name


@cache
def remedies() -> tuple[tuple[str, str, str], ...]:
    """File, place and text of each remedy of the source, with `FILLED` where something is filled in."""
    return tuple((module.name, place, text) for module, place, found in _remedies() for text in found)


@cache
def _remedies() -> tuple[tuple[Module, str, tuple[str, ...]], ...]:
    found = []
    for module in modules():
        for node in module.nodes:
            value: ast.expr | None = None
            if (isinstance(node, ast.keyword) and node.arg == "remedy") or (
                isinstance(node, ast.Assign) and getattr(node.targets[0], "attr", None) == "remedy"
            ):
                value = node.value
            if value is not None and not _is_passed_on(value, module):
                found.append((module, f"{module.name}:{value.lineno}", tuple(_texts(value, module))))
    return tuple(found)


def _is_passed_on(node: ast.expr, module: Module) -> bool:
    """Return whether it is the remedy of an error or an argument of the same name, which is read where it is stated."""
    if isinstance(node, ast.Attribute):
        return node.attr == "remedy"
    function = module.owner.get(node)
    if isinstance(node, ast.Name) and function is not None:
        arguments = {one.arg for one in (*function.args.args, *function.args.kwonlyargs)}
        return node.id == "remedy" and node.id in arguments
    return False


def _texts(node: ast.expr | None, module: Module, depth: int = 0) -> Iterator[str]:
    """The texts of an expression; those of its branches are several."""
    if node is None or depth > 6:
        return
    if isinstance(node, ast.Constant):
        if isinstance(node.value, str):
            yield node.value
    elif isinstance(node, ast.JoinedStr):
        # What is filled in may itself be one of several texts, such as "or" of two options.
        pieces = [
            [str(part.value)] if isinstance(part, ast.Constant) else _filled(part, module, depth)
            for part in node.values
        ]
        for chosen in islice(product(*pieces), 64):
            yield "".join(chosen)
    elif isinstance(node, ast.IfExp):
        yield from _texts(node.body, module, depth)
        yield from _texts(node.orelse, module, depth)
    elif isinstance(node, ast.BoolOp):
        for one in node.values:
            yield from _texts(one, module, depth)
    elif isinstance(node, ast.BinOp):
        rights = list(_texts(node.right, module, depth)) or [FILLED]
        for left in list(_texts(node.left, module, depth)) or [FILLED]:
            for right in rights:
                if left != FILLED or right != FILLED:
                    yield left + right
    elif isinstance(node, ast.Dict):
        for one in node.values:
            yield from _texts(one, module, depth)
    elif isinstance(node, ast.Subscript):
        yield from _texts(node.value, module, depth + 1)
    elif isinstance(node, ast.Name):
        function = module.owner.get(node)
        local = _assigned_in(function) if function is not None else {}
        home, name = _find(module, node.id)
        for one in local.get(node.id) or home.constants.get(name, []):
            yield from _texts(one, module if node.id in local else home, depth + 1)
    elif isinstance(node, ast.Call):
        if isinstance(node.func, ast.Attribute) and node.func.attr == "get":
            yield from _texts(node.func.value, module, depth + 1)
            for one in node.args[1:]:
                yield from _texts(one, module, depth)
        elif isinstance(node.func, ast.Name):
            home, name = _find(module, node.func.id)
            for part in ast.walk(home.functions[name]) if name in home.functions else ():
                if isinstance(part, ast.Return):
                    yield from _texts(part.value, home, depth + 1)


def _filled(part: ast.expr, module: Module, depth: int) -> list[str]:
    inner = part.value if isinstance(part, ast.FormattedValue) else part
    if isinstance(inner, ast.IfExp | ast.Constant | ast.JoinedStr | ast.Name):
        return list(dict.fromkeys(_texts(inner, module, depth + 1))) or [FILLED]
    return [FILLED]


@cache
def messages() -> tuple[tuple[str, str, str], ...]:
    """File, place and text of each text of the source that is no documentation: messages, notes, warnings, headings."""
    return tuple(_messages())


def _messages() -> Iterator[tuple[str, str, str]]:
    for module in modules():
        left_out = module.documentation()
        inner = {part for node in module.nodes if isinstance(node, ast.JoinedStr) for part in node.values}
        for node in module.nodes:
            if isinstance(node, ast.Constant | ast.JoinedStr) and node not in left_out and node not in inner:
                text = "".join(
                    str(part.value) if isinstance(part, ast.Constant) else FILLED
                    for part in (node.values if isinstance(node, ast.JoinedStr) else [node])
                )
                yield module.name, f"{module.name}:{node.lineno}", text


@cache
def subcommands(verb: str) -> tuple[str, ...]:
    """The subcommands of a verb that has some, as its help lists or names them."""
    text = help_of(verb)
    usage = re.match(rf"usage: mirror {re.escape(verb)} ([a-z-]+(?:\|[a-z-]+)*) \[options\]", text)
    listed = usage.group(1).split("|") if usage else []
    flat = re.sub(r"[\s│]+", " ", text)
    named = re.findall(rf"`mirror {re.escape(verb)} ([a-z]+)`", flat)
    return tuple(dict.fromkeys([*listed, *(name for name in named if not usage)]))


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
        if stated and not list(commands_in(text)):
            count += 1
            if verbs is None:
                wrong.append(f"{place}: RAISED_BY does not say which verb raises it: {text}")
            elif not any(stated <= options_of(verb) for verb in verbs):
                wrong.append(f"{place}: none of {verbs} has {sorted(stated)}: {text}")
    assert wrong == []
    assert count > 50


def test_places_that_are_options_are_those_of_a_verb_that_can_raise_the_error() -> None:
    """An error without a remedy of its own says that the option at its place is given as expected."""
    wrong, count = [], 0
    for module in modules():
        verbs = next((verbs for folder, verbs in RAISED_BY.items() if module.name.startswith(folder)), None)
        for node in module.nodes:
            if not (isinstance(node, ast.keyword) and node.arg == "place"):
                continue
            for text in _texts(node.value, module):
                stated = set(re.findall(r"^--[a-z][a-z0-9-]*", text.replace(FILLED, " ")))
                count += len(stated)
                known = all_options() if verbs is None else frozenset().union(*map(options_of, verbs))
                if stated - known:
                    wrong.append(f"{module.name}:{node.value.lineno}: {sorted(stated)} of {verbs}")
    assert wrong == []
    assert count > 200


def test_remedies_have_no_call_where_a_verb_leads() -> None:
    calls = [
        f"{place}: {text}" for name, place, text in remedies() if name not in ONLY_FROM_PYTHON and _CALL.search(text)
    ]
    assert calls == []


def test_the_modules_that_are_listed_have_calls() -> None:
    found = {name for name, _, text in remedies() if _CALL.search(text)}
    assert found >= ONLY_FROM_PYTHON


def test_few_remedies_are_unread() -> None:
    unread = [place for _, place, found in _remedies() if not found]
    assert len(unread) <= UNREAD, unread
    assert len(_remedies()) > 700


def test_options_of_messages_exist() -> None:
    """Sentences that name an option of `mirror`; single words are options that the toolkit passes to programs."""
    wrong, count = [], 0
    for name, place, text in messages():
        if " " in text.strip() and name not in OF_OTHER_PROGRAMS:
            # A quotation mark stands before the variables of styles.
            stated = set(re.findall(r"(?<![\w\"-])--[a-z][a-z0-9-]*", text))
            count += len(stated)
            if stated - all_options():
                wrong.append(f"{place}: no verb has {sorted(stated - all_options())}: {text!r:.120}")
    assert wrong == []
    assert count > 300


def test_commands_of_messages_exist() -> None:
    wrong = []
    for _, place, text in messages():
        for command in re.findall(r"`mirror ([a-z][^`]*)`", text):
            for verb, words in commands_in(f"mirror {command}"):
                if verb not in all_commands():
                    wrong.append(f"{place}: no verb {verb}")
                    continue
                known = words and words[0] in subcommands(verb)
                key = f"{verb} {words[0]}" if known else verb
                options = {word.split("=")[0] for word in words if word.startswith("--")} - {"--help"}
                if options - options_of(key):
                    wrong.append(f"{place}: mirror {key} has no {sorted(options - options_of(key))}")
    assert wrong == []


def test_no_text_installs_the_toolkit_by_a_name_that_is_not_registered() -> None:
    assert [place for _, place, text in messages() if re.search(r"pip install[^`]*mirror[-_]dataset", text)] == []


def test_from_a_checkout() -> None:
    assert shlex.split(install_command("view")) == ["pip", "install", "-e", f"{ROOT}[view]"]
    assert upgrade_command() == f"git -C {ROOT} pull && pip install --upgrade -e {ROOT}"


@pytest.mark.parametrize(
    ("said", "source"),
    [
        (None, "{name}[view]"),
        ({"url": "file:///nowhere/at/all", "dir_info": {}}, "{name}[view]"),
        ({"url": "file://{here}", "dir_info": {}}, "{name}[view] @ file://{here}"),
        (
            {"url": "https://a.b/c.git", "vcs_info": {"vcs": "git", "requested_revision": "v1", "commit_id": "0"}},
            "{name}[view] @ git+https://a.b/c.git@v1",
        ),
        ({"url": "https://a.b/c.whl", "archive_info": {}}, "{name}[view] @ https://a.b/c.whl"),
    ],
)
def test_from_an_address(
    said: dict[str, object] | None, source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site, here = tmp_path / "site", tmp_path / "a folder"
    about = site / "mirror_dataset-9.dist-info"
    about.mkdir(parents=True)
    here.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {NAME}\nVersion: 9\n")
    if said is not None:
        (about / "direct_url.json").write_text(json.dumps(said).replace("{here}", str(here)))
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setattr(installation, "checkout_folder", lambda: None)
    wanted = source.format(name=NAME, here=here)
    assert shlex.split(install_command("view")) == ["pip", "install", wanted]
    assert shlex.split(upgrade_command())[-1] == wanted.replace("[view]", "")
