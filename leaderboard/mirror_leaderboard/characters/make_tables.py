"""Makes the tables of this folder from data files of the Unicode Consortium, whose licence lies beside them.

``python -m mirror_leaderboard.characters.make_tables FOLDER`` reads ``confusables.txt``, ``IdentifierStatus.txt``,
``Scripts.txt``, ``ScriptExtensions.txt`` and ``PropertyValueAliases.txt`` of a folder. ``confusables.tsv`` has all
mappings of the first, without its comments; ``allowed.tsv`` has the ranges of characters that may stand in identifiers,
with their sets of scripts.
"""

from __future__ import annotations

import itertools
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from mirror.schema.files import sha256_bytes, write_bytes

HERE: Final = Path(__file__).parent
_NOTICE: Final = (
    "# Data of the Unicode Consortium, reduced to the columns that are used. Licence: LICENSE (Unicode-3.0).\n"
)


def main(folder: Path) -> None:
    """Write both tables."""
    mappings = (f"{fields[0]}\t{fields[1]}" for fields in _read_fields(folder / "confusables.txt") if fields[2] == "MA")
    _write("confusables.tsv", folder, ("confusables.txt",), mappings)
    names = ("IdentifierStatus.txt", "Scripts.txt", "ScriptExtensions.txt")
    scripts = _read_ranges(folder / names[1])
    # Extensions replace the script of a character.
    aliases = {row[1]: row[2] for row in _read_fields(folder / "PropertyValueAliases.txt") if row[0] == "sc"}
    extensions = {
        code: " ".join(aliases[name] for name in value.split())
        for code, value in _read_ranges(folder / names[2]).items()
    }
    known = {**scripts, **extensions}
    allowed = sorted(code for code, status in _read_ranges(folder / names[0]).items() if status == "Allowed")
    _write("allowed.tsv", folder, names, _join_ranges([(code, known.get(code, "Unknown")) for code in allowed]))


def _read_fields(path: Path) -> Iterator[list[str]]:
    for line in path.read_text(encoding="utf-8-sig").splitlines():
        fields = [field.strip() for field in line.partition("#")[0].split(";")]
        if len(fields) > 1:
            yield fields


def _read_ranges(path: Path) -> dict[int, str]:
    values = {}
    for codes, value, *_ in _read_fields(path):
        first, _, last = codes.partition("..")
        values.update(dict.fromkeys(range(int(first, 16), int(last or first, 16) + 1), value))
    return values


def _join_ranges(rows: list[tuple[int, str]]) -> Iterator[str]:
    numbered = enumerate(rows)
    for _, group in itertools.groupby(numbered, key=lambda one: (one[1][0] - one[0], one[1][1])):
        members = [row for _, row in group]
        yield f"{members[0][0]:04X}\t{members[-1][0]:04X}\t{members[0][1]}"


def _write(name: str, folder: Path, sources: tuple[str, ...], lines: Iterator[str]) -> None:
    head = _NOTICE
    for source in sources:
        data = (folder / source).read_bytes()
        version = re.search(rb"[Vv]ersion: *([\d.]+)|-([\d.]+)\.txt", data)
        number = "not stated" if version is None else (version[1] or version[2]).decode()
        head += f"# {source}, version {number}, sha256 {sha256_bytes(data)}\n"
    write_bytes(HERE / name, (head + "\n".join(lines) + "\n").encode())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
