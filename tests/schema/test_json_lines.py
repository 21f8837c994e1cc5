"""Files of JSON lines: cut-off lines, several writers, broken lines."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from mirror.errors import DatasetError
from mirror.schema.json_lines import LineReader, append_line, decode_object, read_lines


def test_a_cut_off_line_is_left_out_and_then_removed(tmp_path: Path) -> None:
    file = tmp_path / "new" / "rows.jsonl"
    assert read_lines(file, decode_object) == []
    append_line(file, '{"a": 1}')
    whole = file.read_bytes()
    for cut in ('{"a": 2', '{"a": "\u00e9'.encode()[:-1].decode("latin-1"), "x" * 70_000):
        file.write_bytes(whole + cut.encode("latin-1"))
        assert read_lines(file, decode_object) == [{"a": 1}]
        append_line(file, '{"a": 3}', sync=True)
        assert file.read_bytes() == whole + b'{"a": 3}\n'
    file.write_bytes(b'{"a"')
    append_line(file, '{"a": 4}')
    assert read_lines(file, decode_object) == [{"a": 4}]


def test_a_reader_reads_what_is_new(tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    reader = LineReader(file, decode_object)
    assert reader.read() == []
    append_line(file, '{"a": 1}')
    assert reader.read() == [(1, {"a": 1})]
    with file.open("ab") as handle:
        handle.write(b'{"a": 2}\n{"a": ')
    assert reader.read() == [(2, {"a": 2})]
    with file.open("ab") as handle:
        handle.write(b"3}\n")
    assert reader.read() == [(3, {"a": 3})]
    assert reader.read() == []


@pytest.mark.parametrize("line", ["{", "[1]", '{"a": 1, "a": 2}', ""])
def test_a_broken_line_is_named(tmp_path: Path, line: str) -> None:
    file = tmp_path / "rows.jsonl"
    file.write_text(f'{{"a": 1}}\n{line}\n{{"a": 3}}\n')
    with pytest.raises(DatasetError, match=r"line 2.*broken|broken.*line 2"):
        read_lines(file, decode_object)


def test_a_missing_key_is_named(tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    append_line(file, '{"a": 1}')
    with pytest.raises(DatasetError, match="no key 'b'"):
        read_lines(file, lambda line: decode_object(line)["b"])


def test_processes_append_whole_lines(tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    program = (
        "import json, pathlib, sys\n"
        "from mirror.schema.json_lines import append_line\n"
        "for number in range(40):\n"
        "    row = {'writer': sys.argv[2], 'number': number, 'text': 'x' * 20_000}\n"
        "    append_line(pathlib.Path(sys.argv[1]), json.dumps(row))\n"
    )
    writers = [subprocess.Popen([sys.executable, "-c", program, str(file), name]) for name in "ab"]
    assert [writer.wait() for writer in writers] == [0, 0]
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    assert rows == read_lines(file, decode_object)
    for name in "ab":
        assert [row["number"] for row in rows if row["writer"] == name] == list(range(40))


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="it is a folder"):
        append_line(tmp_path, "{}")
