"""Builds the site of the documentation: ``make docs``, or ``python docs/make_site.py [--sources-only]``.

The pages are those of docs and its folders, and README.md as the first page; the references of the command line and of
the Python names are made from the code. Zensical builds them by mkdocs.yml; a link to nothing ends the build.
"""

from __future__ import annotations

import csv
import importlib
import inspect
import io
import os
import re
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path, PurePosixPath
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
SOURCES: Final = ROOT / "build" / "docs"
"""The folder of the pages that Zensical reads; mkdocs.yml names it."""
STUDIES: Final = ROOT / "benchmarks" / "studies"
"""The folder of studies: their READMEs, reports and figures by seed are pages of results."""
PACKAGES: Final = (
    "mirror",
    "mirror.dataset",
    "mirror.geometry",
    "mirror.metrics",
    "mirror.metrics.safety",
    "mirror.recordings",
    "mirror.protocols",
    "mirror.methods",
    "mirror.annotation",
    "mirror.calibration",
    "mirror.privacy",
    "mirror.synth",
)
"""The packages whose ``__all__`` is the reference of Python names."""
_LINK: Final = re.compile(r"(\]\()([^)\s#]+)(#[^)]*)?(\))")
_FILES: Final = "files"
"""Folder of the site with the files of the repository that pages link to."""


def write_sources(out: Path) -> list[Path]:
    """Write the pages that the site is built from.

    Args:
        out: the folder; what it held is removed.

    Returns:
        The pages.
    """
    shutil.rmtree(out, ignore_errors=True)
    (out / "reference").mkdir(parents=True)
    shutil.copytree(ROOT / "docs" / "images", out / "images")
    pages = {path: out / path.relative_to(ROOT / "docs") for path in sorted((ROOT / "docs").rglob("*.md"))}
    pages[ROOT / "README.md"] = out / "index.md"
    for folder in sorted(path.parent for path in STUDIES.glob("*/README.md")):
        pages[folder / "README.md"] = out / "results" / f"{folder.name}.md"
        if (folder / "report.md").is_file():
            pages[folder / "report.md"] = out / "results" / f"{folder.name}-report.md"
        if (folder / "seeds.csv").is_file():
            pages[folder / "seeds.csv"] = out / "results" / f"{folder.name}-seeds.md"
    pages[ROOT / "CHANGELOG.md"] = out / "changelog.md"
    pages[ROOT / "CONTRIBUTING.md"] = out / "contributing.md"
    pages[ROOT / "SECURITY.md"] = out / "security.md"
    for source, page in pages.items():
        page.parent.mkdir(parents=True, exist_ok=True)
        text = describe_figures(source) if source.suffix == ".csv" else source.read_text()
        page.write_text(_rewrite_links(text, source, pages, out))
    commands, names = out / "reference" / "command-line.md", out / "reference" / "python.md"
    commands.write_text(describe_commands())
    names.write_text(describe_names())
    return [*pages.values(), commands, names]


def describe_figures(file: Path) -> str:
    """Describe the figures of a study by seed: its CSV as a table."""
    rows = list(csv.reader(file.open(newline="")))
    name = file.parent.name
    lines = [
        f"# Figures as CSV: {name.replace('_', ' ')}",
        "",
        f"This page is the file benchmarks/studies/{name}/{file.name}, for those who compute with the figures of",
        "[the study](README.md).",
        "",
        *("| " + " | ".join(cell.replace("*", "\\*") for cell in row) + " |" for row in rows),
    ]
    lines.insert(6, "|---" * len(rows[0]) + "|")
    return "\n".join(lines) + "\n"


def _rewrite_links(text: str, source: Path, pages: dict[Path, Path], out: Path) -> str:
    """Return a page whose links lead to pages of the site; other files of the repository are copied into the site."""

    def rewrite(found: re.Match[str]) -> str:
        opening, address, heading, closing = found.groups()
        target = (source.parent / address).resolve()
        if "://" in address or address.startswith("mailto:") or not target.exists() or target.is_relative_to(out):
            return found.group(0)
        if target in pages:
            copy = pages[target]
        elif target.is_relative_to(ROOT / "docs" / "images"):
            copy = out / target.relative_to(ROOT / "docs")
        else:
            copy, heading = _copy_file(target, out), None
        return f"{opening}{os.path.relpath(copy, pages[source].parent)}{heading or ''}{closing}"

    return _LINK.sub(rewrite, text)


def _copy_file(target: Path, out: Path) -> Path:
    """Copy a file of the repository into the site, a folder as the list of its files; returns the copy."""
    place = PurePosixPath(_FILES, target.relative_to(ROOT).as_posix())
    # Other documents stay text: their own links lead into the repository.
    copy = out / (f"{place}.txt" if target.is_dir() or target.suffix == ".md" else place)
    copy.parent.mkdir(parents=True, exist_ok=True)
    if target.is_dir():
        copy.write_text("\n".join(sorted(path.name for path in target.iterdir())) + "\n")
    else:
        shutil.copy(target, copy)
    return copy


def describe_commands() -> str:
    """Describe the command line: the help of every verb and subcommand, as they print it."""
    from mirror.cli.verbs import HEADINGS, all_commands

    lines = [
        "# Command line",
        "",
        "This page is the help of every verb, for those who look an option up; `mirror VERB --help` prints the same.",
        "It is made from the code. What the verbs are for stands in the pages of the tutorials and how-to guides.",
        "",
    ]
    commands = all_commands()
    for group, heading in HEADINGS.items():
        lines += [f"## {heading}", ""]
        for verb, command in commands.items():
            if command.group == group:
                lines += _describe_verb(verb, command.summary)
    return "\n".join(lines)


def _describe_verb(verb: str, summary: str) -> list[str]:
    text = read_help(verb)
    lines = [f"### mirror {verb}", "", f"{summary[0].upper()}{summary[1:]}.", "", "```text", text.strip(), "```", ""]
    first = text.split("\n", 1)[0]
    for sub in re.findall(rf"usage: mirror {verb} ([\w|-]+\|[\w|-]+)", first)[:1]:
        for name in sub.split("|"):
            lines += [f"#### mirror {verb} {name}", "", "```text", read_help(f"{verb} {name}").strip(), "```", ""]
    return lines


def read_help(words: str) -> str:
    """Return the help of a command in 100 columns, without colours."""
    from mirror.cli.main import main

    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(io.StringIO()), suppress(SystemExit):
        main([*words.split(), "--help"])
    text = re.sub(r"\x1b\[[0-9;]*m", "", said.getvalue())
    return "\n".join(line.rstrip() for line in text.splitlines())


def describe_names() -> str:
    """Describe the public Python names: what mkdocstrings reads from the docstring of each."""
    lines = [
        "# Python names",
        "",
        "This page is the reference of the public names, for those who call MIRROR from Python; it is made from their",
        "docstrings, whose examples a test runs. Names that are not here may change without a line in the changelog.",
        "",
    ]
    described: dict[str, str] = {}
    for package in PACKAGES:
        module = importlib.import_module(package)
        summary = (inspect.getdoc(module) or "").split("\n\n", 1)[0].replace("\n", " ")
        lines += [f"## {package}", "", summary, ""]
        for name in module.__all__:
            value = getattr(module, name)
            if not (inspect.isclass(value) or inspect.isfunction(value)):
                lines += [f"- `{package}.{name}`", ""]
                continue
            path = f"{value.__module__}.{value.__qualname__}"
            if path in described:
                lines += [f"- `{package}.{name}`: see `{described[path]}`", ""]
                continue
            described[path] = f"{package}.{name}"
            lines += [f"::: {path}", "    options:", "      heading_level: 3", f"      heading: {package}.{name}", ""]
    return "\n".join(lines)


def main() -> int:
    """Write the sources and build the site; returns the exit code of the build."""
    builder = Path(sys.executable).with_name("zensical")
    if "--sources-only" not in sys.argv[1:] and not builder.is_file():
        print(f"no {builder}: install the extra, pip install -c constraints.txt -e '.[docs]'", file=sys.stderr)
        return 2
    # The help of verbs is formatted for this width.
    os.environ.update(COLUMNS="100", NO_COLOR="1", TERM="dumb")
    pages = write_sources(SOURCES)
    if "--sources-only" in sys.argv[1:]:
        print(f"{len(pages)} pages in {SOURCES}")
        return 0
    built = subprocess.run([builder, "build", "--strict"], cwd=ROOT, check=False)
    if built.returncode == 0:
        print(f"site: {ROOT / 'build' / 'site' / 'index.html'}")
    return built.returncode


if __name__ == "__main__":
    sys.exit(main())
