"""Changes of one token in a source file."""

from __future__ import annotations

import ast
import io
import tokenize
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

_SWAPS: Final = "+ - / += -= / *= /= / & | / << >> / == != / and or / True False / min max / minimum maximum / any all"
_PAIRS: Final = [pair.split() for pair in f"{_SWAPS} / argmin argmax / break continue".split(" / ")]
# Replacements of a token; a number is increased by one, or doubled where one is too little.
_OTHERS: Final[Mapping[str, tuple[str, ...]]] = {
    **{old: (new,) for text, two in _PAIRS for old, new in ((text, two), (two, text))},
    **{"*": ("+", "/"), "/": ("*",), "//": ("*",), "%": ("*",), "**": ("*",), "~": ("",), "not": ("",)},
    **{"<": ("<=", ">"), "<=": ("<", ">="), ">": (">=", "<"), ">=": (">", "<="), "is": ("is not",), "in": ("not in",)},
}
_LARGE: Final = 1e6
_LAYOUT: Final = (tokenize.NL, tokenize.NEWLINE, tokenize.COMMENT, tokenize.INDENT, tokenize.DEDENT)
_LOGS: Final = ("debug", "info", "warning", "warn", "error", "print")
_Place = tuple[int, int]


@dataclass(frozen=True)
class Mutant:
    """A change of one token.

    Attributes:
        file: path in the tree.
        row: number of the line, from 1.
        new_line: the complete line with the change.
        after: text of the line of code before it, stripped.
        line: text of the line without the change, stripped.
        becomes: text of the line with the change, stripped.
        repeat: number of equal changes of equal pairs of lines in the file before this one.
        function: first line of the innermost function that contains it; 0: none.
    """

    file: str
    row: int
    new_line: str
    after: str
    line: str
    becomes: str
    repeat: int
    function: int

    @property
    def name(self) -> str:
        """Key of its outcome, which does not change when the line moves to another place or file."""
        return mutant_name(self.after, self.line, self.becomes, self.repeat)

    def applied(self, text: str) -> str:
        """Return the source file's text with the change."""
        lines = text.splitlines()
        return "\n".join([*lines[: self.row - 1], self.new_line, *lines[self.row :], ""])


def mutant_name(after: str, line: str, becomes: str, repeat: int) -> str:
    """Return the name of the mutant with these attributes."""
    return f"{after} | {line} -> {becomes}" + (f" #{repeat}" if repeat else "")


def compiles(text: str) -> bool:
    """Return whether a source file's text is Python."""
    try:
        compile(text, "mutant", "exec")
    except SyntaxError:
        return False
    return True


def mutants(file: str, text: str) -> Iterator[Mutant]:
    """Yield all mutants of a source file; some may not compile (``for x not in y``).

    Strings, annotations (except calls in them), decorators, ``raise`` statements, logging and ``__all__`` are not
    changed.
    """
    excluded, included, functions = _ranges(ast.parse(text))
    lines = text.splitlines()
    tokens = [token for token in tokenize.generate_tokens(io.StringIO(text).readline) if token.type not in _LAYOUT]
    strings = ["", *(token.string for token in tokens), ""]
    repeats: Counter[tuple[str, str, str]] = Counter()
    for index, token in enumerate(tokens):
        row, column = token.start
        if _contains(excluded, token.start) and not _contains(included, token.start):
            continue
        for other in _replacements(token, strings[index], strings[index + 2]):
            line = lines[row - 1]
            rest = line[column + len(token.string) :]
            new_line = line[:column] + other + (rest if other else rest.lstrip())
            above = (text.strip() for text in reversed(lines[: row - 1]))
            after = next((text for text in above if text and not text.startswith("#")), "")
            change = after, line.strip(), new_line.strip()
            inner = max((first for first, last in functions if first <= row <= last), default=0)
            yield Mutant(file, row, new_line, *change, repeats[change], inner)
            repeats[change] += 1


def _replacements(token: tokenize.TokenInfo, before: str, after: str) -> tuple[str, ...]:
    text = token.string
    if token.type == tokenize.NUMBER:
        number = ast.literal_eval(text)
        return (repr(number + 1 if abs(number) < _LARGE else number * 2),)
    # Stars before arguments are not operators, and only `not` changes in `is not` and `not in`.
    operand = before[-1:].isalnum() or before[-1:] in ("_", ")", "]", "}") or before[-1:] in ("'", '"')
    star = text in ("*", "**") and not (operand and before not in ("lambda", "return", "yield", "in", "print"))
    if star or (text == "is" and after == "not") or (text == "in" and before == "not"):
        return ()
    # Names of keyword arguments.
    return () if token.type == tokenize.NAME and after == "=" else _OTHERS.get(text, ())


def _contains(ranges: list[tuple[_Place, _Place]], place: _Place) -> bool:
    return any(first <= place < end for first, end in ranges)


def _ranges(tree: ast.AST) -> tuple[list[tuple[_Place, _Place]], list[tuple[_Place, _Place]], list[tuple[int, int]]]:
    """Excluded ranges, ranges within them that are included, and the first and last lines of functions."""
    excluded: list[ast.expr | ast.stmt] = []
    included: list[ast.expr | ast.stmt] = []
    functions = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            functions.append(
                (min(text.lineno for text in (node, *node.decorator_list)), node.end_lineno or node.lineno)
            )
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            excluded += node.decorator_list
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets):
            excluded.append(node)
        if isinstance(node, ast.Raise):
            excluded.append(node)
        if isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in _LOGS:
            excluded.append(node)
        for annotation in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if isinstance(annotation, ast.expr):
                excluded.append(annotation)
                included += [call for call in ast.walk(annotation) if isinstance(call, ast.Call)]
    return _spans(excluded), _spans(included), functions


def _spans(nodes: list[ast.expr | ast.stmt]) -> list[tuple[_Place, _Place]]:
    return [((n.lineno, n.col_offset), (n.end_lineno or 0, n.end_col_offset or 0)) for n in nodes]
