"""Which tokens are changed, their replacements, and the names of mutants."""

from __future__ import annotations

from benchmarks.mutants.benchmark import ROOT, find, read_reasons, reason_name
from benchmarks.mutants.mutations import compiles, mutants

SOURCE = '''
@cached(size=7)
def first(a: Annotated[int, Field(ge=0)], *rest: int, **more: int | None) -> bool:
    """Take 1 and + another."""
    for one in rest:
        if a not in rest and a < 2:
            raise ValueError(f"{a} - 3")
    log.debug("%d", 4)
    return not call(*rest, a * 0.5, key=a is not None)  # 6
'''


def test_operators_numbers_and_logic_change_and_text_does_not() -> None:
    found = [mutant for mutant in mutants("a.py", SOURCE) if compiles(mutant.applied(SOURCE))]
    assert [(mutant.row, mutant.becomes) for mutant in found] == [
        (3, "def first(a: Annotated[int, Field(ge=1)], *rest: int, **more: int | None) -> bool:"),
        (6, "if a in rest and a < 2:"),
        (6, "if a not in rest or a < 2:"),
        (6, "if a not in rest and a <= 2:"),
        (6, "if a not in rest and a > 2:"),
        (6, "if a not in rest and a < 3:"),
        (9, "return call(*rest, a * 0.5, key=a is not None)  # 6"),
        (9, "return not call(*rest, a + 0.5, key=a is not None)  # 6"),
        (9, "return not call(*rest, a / 0.5, key=a is not None)  # 6"),
        (9, "return not call(*rest, a * 1.5, key=a is not None)  # 6"),
        (9, "return not call(*rest, a * 0.5, key=a is None)  # 6"),
    ]
    # The first line of the function is that of its decorator, as in its code object.
    assert {mutant.function for mutant in found} == {2}


def test_only_the_changed_line_differs() -> None:
    for mutant in mutants("a.py", SOURCE):
        before, after = SOURCE.splitlines(), mutant.applied(SOURCE).splitlines()
        assert [row for row, pair in enumerate(zip(before, after, strict=True), 1) if pair[0] != pair[1]] == [
            mutant.row
        ]


def test_a_mutant_keeps_its_name_where_its_lines_move() -> None:
    names = [mutant.name for mutant in mutants("a.py", SOURCE)]
    assert [mutant.name for mutant in mutants("b.py", "import x\n\n# A note.\n" + SOURCE)] == names
    assert len(set(names)) == len(names)
    twice = [mutant.name for mutant in mutants("a.py", SOURCE + SOURCE)]
    assert len(set(twice)) == len(twice)


def test_the_sample_is_found_by_name_and_new_code_does_not_change_it() -> None:
    names = [mutant.name for mutant in mutants("a.py", SOURCE)]
    sample = [names[4], names[0]]
    present = list(mutants("b.py", "def other(c: int) -> int:\n    return c + 1\n" + SOURCE))
    assert [mutant.name for mutant in find(sample, present)] == sample
    gone = list(mutants("b.py", SOURCE.replace("Field(ge=0)", "Field()")))
    assert [mutant.name for mutant in find(sample, gone)] == sample[:1]


def test_every_reason_is_that_of_a_mutant_of_the_present_source() -> None:
    for reason in read_reasons():
        file = reason["file"]
        assert reason_name(reason) in {mutant.name for mutant in mutants(file, (ROOT / file).read_text())}, file
