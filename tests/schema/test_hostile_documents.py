"""Documents and names that are nested too deep, too long or no names: refused with an error, by every reader."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from pydantic import TypeAdapter, ValidationError

from hybridworldsim.simulator.remote.driver_file import read_driver_file
from mirror.cli.main import main
from mirror.dataset.store import Store
from mirror.errors import DatasetError, MirrorError, SchemaError
from mirror.protocols.document import parse_protocol
from mirror.recordings.readers.message_logs.topics_file import read_topics_file
from mirror.schema.bundle import Bundle
from mirror.schema.documents import InnerPath
from mirror.schema.files import parse_json
from mirror.schema.links import is_file_name, require_inside
from mirror.schema.scenario import parse_scenario
from mirror.schema.strict_toml import TomlError, decode_toml

DEEP = 50_000
NESTED = [
    b"a = " + b"[" * DEEP + b"]" * DEEP,
    b"a = " + b"{b = " * DEEP + b"1" + b"}" * DEEP,
    b"[" + b".".join([b"a"] * DEEP) + b"]",
    b".".join([b"a"] * DEEP) + b" = 1",
]
OTHERS = [b"\xff\xfe", b"a = " + b"9" * 5000, b"a = ", b"a = 1\na = 2"]


@pytest.mark.parametrize("data", [*NESTED, *OTHERS], ids=range(len(NESTED) + len(OTHERS)))
def test_every_reader_of_toml_refuses_it(data: bytes, tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    file.write_bytes(data)
    with pytest.raises(TomlError):
        decode_toml(data)
    readers: list[Callable[[], object]] = [
        lambda: parse_protocol(data, "x.toml"),
        lambda: parse_scenario(data, "x.toml"),
        lambda: read_driver_file(file),
        lambda: read_topics_file(file),
    ]
    for read in readers:
        with pytest.raises(MirrorError) as caught:
            read()
        assert "x.toml" in str(caught.value)


def test_documents_of_usual_depth_are_read() -> None:
    assert decode_toml(b"[a.b]\nc = [[1, 2], [{d = 3}]]") == {"a": {"b": {"c": [[1, 2], [{"d": 3}]]}}}


def test_json_nested_too_deep_is_refused() -> None:
    for data in (b"[" * DEEP + b"]" * DEEP, b'{"files": ' * DEEP + b"1" + b"}" * DEEP):
        with pytest.raises(SchemaError, match="deep"):
            parse_json(data, Bundle, "bundle.json")


@pytest.mark.parametrize("name", ["a" * 300, "folder/" + "b" * 256, "a\0b", "x/" * 2100 + "y", "ä" * 128])
def test_names_that_no_file_can_have(name: str, tmp_path: Path) -> None:
    assert not is_file_name(name)
    with pytest.raises(ValidationError, match="no name of a file"):
        TypeAdapter(InnerPath).validate_python(name)
    with pytest.raises(DatasetError, match="no name of a file"):
        require_inside(tmp_path, name)
    with pytest.raises(DatasetError, match="no name of a file"):
        Store(tmp_path).read(name)
    document = {"split": "s", "protocols": [], "dataset_hash": "0", "licence": "x"}
    files = {name: {"bytes": 1, "sha256": "0" * 64}}
    with pytest.raises(SchemaError):
        parse_json(json.dumps({**document, "files": files}).encode(), Bundle, "bundle.json")


def test_names_that_files_can_have() -> None:
    for name in ("a" * 255, "ä" * 127, "a/b/c", "."):
        assert is_file_name(name)


@pytest.mark.parametrize(
    "words", ["info {}", "check {}", "synth --preset tiny --out {}", "dataset fetch {} --out x", "view {}"]
)
def test_the_command_line_names_a_path_that_is_too_long(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words.format("a" * 300).split()) == 2
    said = capsys.readouterr().err
    assert "too long" in said and "a" * 40 in said and "255 bytes" in said
