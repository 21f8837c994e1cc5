"""Remedies name commands that work: those of pip before the name is registered, and those of `mirror` as they are."""

from __future__ import annotations

import ast
import io
import json
import re
import shlex
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from mirror import installation
from mirror.cli.main import main
from mirror.cli.verbs import all_commands
from mirror.installation import NAME, install_command, upgrade_command

ROOT = Path(__file__).parents[1]
_NESTED = "annotate calibrate dataset export generate leaderboard protocols recording release rois submission"
OF_THEIR_OWN = frozenset(re.findall("[a-z]+", _NESTED))
"""Verbs that have verbs of their own."""


def texts(part: str) -> Iterator[tuple[str, str]]:
    """Texts of the modules that have a part, with what is filled in as WORD, and where they stand."""
    for folder in ("mirror", "baselines", "leaderboard"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            source = file.read_text()
            for node in ast.walk(ast.parse(source)) if part in source else ():
                text = ""
                if isinstance(node, ast.JoinedStr):
                    text = "".join(str(one.value) if isinstance(one, ast.Constant) else "WORD" for one in node.values)
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    text = node.value
                yield f"{file.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}", text


def test_no_text_installs_the_toolkit_by_a_name_that_is_not_registered() -> None:
    assert [place for place, text in texts("pip") if re.search(r"pip install[^`]*mirror[-_]dataset", text)] == []


def test_verbs_and_options_that_are_named_exist() -> None:
    helps: dict[str, str] = {}
    unknown = []
    for place, text in texts("`mirror "):
        for command in re.findall(r"`mirror ([a-z][^`]*)`", text):
            verb, *rest = command.split()
            if verb not in all_commands():
                unknown.append(f"{place}: mirror {command}")
                continue
            key = " ".join([verb, *(word for word in rest[:1] if verb in OF_THEIR_OWN and word.isalpha())])
            options = [word.split("=")[0] for word in rest if word.startswith("--")]
            if options and key not in helps:
                said = io.StringIO()
                with redirect_stdout(said), pytest.raises(SystemExit):
                    main([*key.split(), "--help"])
                helps[key] = said.getvalue()
            unknown += [f"{place}: mirror {command}" for option in options if option not in helps[key]]
    assert unknown == []
    assert len(helps) > 4


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
