"""Refuses retired words and summary lines without a verb: ``python docs/check_words.py``.

The glossary's table lists the retired words (docs/glossary.md).
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PLACES = ("mirror", "baselines", "leaderboard", "benchmarks", "tests", "examples", "docs")
"""The folders that are checked, besides the documents in the repository's root."""
ALLOWED = {
    "pictures": (
        # Keys of JSON documents: manifest.json, run.json, synth.json, checkpoints, declarations, and output of --json.
        "mirror/dataset/layout.py",
        "mirror/integrity/rules/images.py",
        "mirror/integrity/summary.py",
        "mirror/schema/documents.py",
        "mirror/ingest/traversal.py",
        "tests/golden/hashes.py",
        "mirror/methods/plugin.py",
        "mirror/cli/render.py",
        "mirror/evaluation/submission/models.py",
        "mirror/cli/submission.py",
        "mirror/cli/synth.py",
        "mirror/synth/writing/journal.py",
        "mirror/synth/writing/recordings.py",
        "baselines/hybridworldsim/methods/static.py",
        "baselines/hybridworldsim/model/visibility_cache.py",
        "benchmarks/studies/static_reconstruction/declaration.py",
        "benchmarks/studies/static_reconstruction/run_job.py",
        "benchmarks/studies/static_reconstruction/truth/exact_street.py",
        "benchmarks/studies/static_reconstruction/truth/lighting.py",
        "benchmarks/studies/static_reconstruction/truth/tables.py",
        "tests/integrity/clean.py",
        "tests/integrity/edits_of_scenes.py",
        "tests/real/test_reconstruction.py",
        "tests/baselines/splatting/test_trainers.py",
        "tests/benchmarks/studies/static_reconstruction/test_records.py",
        "tests/benchmarks/studies/static_reconstruction/test_tables.py",
        # Folders of a board and of a run.
        "leaderboard/mirror_leaderboard/entry.py",
        "baselines/hybridworldsim/training/documents.py",
        "mirror/cli/reconstruct.py",
        "tests/cli/test_reconstruct.py",
        "tests/training/short_run.py",
        "tests/training/test_loop.py",
        "docs/reconstruction/model.md",
        # Texts in tables and manifests: documentation of columns, the column `method`, descriptions of floors.
        "mirror/schema/tables.py",
        "mirror/schema/index_tables.py",
        "mirror/synth/truth/tables.py",
        "mirror/recordings/readers/boreas.py",
        "docs/schema.md",
        "baselines/mirror_baselines/mean_color/submission.py",
        "baselines/mirror_baselines/nearest_frame/submission.py",
    ),
    "picture": (
        # Texts in tables, manifests and PNG files.
        "mirror/schema/tables.py",
        "mirror/schema/index_tables.py",
        "mirror/synth/truth/tables.py",
        "mirror/synth/on_demand/png.py",
        "docs/schema.md",
        "baselines/mirror_baselines/nearest_frame/submission.py",
    ),
    "rivals": (
        # A row of published records.
        "benchmarks/studies/static_reconstruction/report.md",
        "benchmarks/studies/static_reconstruction/choices.py",
    ),
}
"""The files in which a retired word stays because it is serialized or is an option."""
CLAUSE = r"(?:What|Whether|Which|Who|Whose|How|When|Where|Why|Those)\b"
CLAUSES = re.compile(rf'^ *(?:async )?(?:def .*|\).*):\n +r?"""({CLAUSE}.*?)(?:"""|$)', re.M)
"""Functions whose documentation begins with a clause instead of a verb, such as "Return whether"."""
NOUNS = re.compile(
    r"(?:The|An?|All|Some|No|Each|Every|One|Both|Several|Everything|Nothing|None|As|At|By|In|Of|Under)\b"
    r"|[(`\d]|[\w-]+ (?:of|that|between|per|from)\b"
)
"""Beginnings of summary lines that are noun phrases: an article, a shape, a name, or a noun with its attribute."""
VERBS = re.compile(
    r"(?:Append|Check|Continue|Copy|Cut|Draw|Load|Make|Mark|Move|Read|Record|Render|Require|Return|Say|Start|Yield)"
    r" (?:that|from)\b"
)
"""Verbs that such an attribute follows."""


def retired() -> list[str]:
    """Return the words of the glossary's table."""
    table = (ROOT / "docs" / "glossary.md").read_text().partition("## Retired words")[2]
    cells = re.findall(r"^\| ([^|]+) \|", table, re.M)[1:]
    return [word for cell in cells if not cell.startswith("---") for word in cell.split(", ")]


def is_property(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Return whether a function is a property, whose summary says what its value is."""
    return any("property" in ast.unparse(decorator) for decorator in function.decorator_list)


def noun_phrases(text: str) -> Iterator[tuple[int, str]]:
    """Yield line and summary of public functions without a verb, and of public classes that begin with a clause."""

    def visit(parent: ast.Module | ast.ClassDef) -> Iterator[tuple[int, str]]:
        for node in parent.body:
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) or node.name.startswith("_"):
                continue
            summary = (ast.get_docstring(node) or "").partition("\n")[0]
            if isinstance(node, ast.ClassDef):
                yield from visit(node)
                if re.match(CLAUSE, summary):
                    yield node.lineno, summary
            elif NOUNS.match(summary) and not VERBS.match(summary) and not is_property(node):
                yield node.lineno, summary

    yield from visit(ast.parse(text))


def main() -> int:
    """Print each place with a retired word or a summary line without a verb; 1 if there is one."""
    words = re.compile(rf"\b({'|'.join(map(re.escape, retired()))})\b")
    files = [*ROOT.glob("*.md"), *(file for place in PLACES for file in (ROOT / place).rglob("*.[pm][yd]"))]
    hits = 0
    for file in sorted(files):
        name = file.relative_to(ROOT).as_posix()
        text = file.read_text()
        if name == "docs/glossary.md":
            text = text.partition("## Retired words")[0]
        for clause in CLAUSES.finditer(text) if file.suffix == ".py" else ():
            hits += 1
            number = text.count("\n", 0, clause.start(1)) + 1
            print(f"{name}:{number}: {clause[1][:40]!r}: begin with a verb, such as 'Return whether'")
        for number, summary in noun_phrases(text) if file.suffix == ".py" and not name.startswith("tests/") else ():
            hits += 1
            print(f"{name}:{number}: {summary[:40]!r}: begin with a verb, or say what the class is")
        for number, line in enumerate(text.splitlines(), start=1):
            for word in words.findall(line):
                if name != "docs/check_words.py" and name not in ALLOWED.get(word, ()):
                    hits += 1
                    print(f"{name}:{number}: {word!r} is retired: see docs/glossary.md")
    return int(hits > 0)


if __name__ == "__main__":
    sys.exit(main())
