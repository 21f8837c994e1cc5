"""Ambiguous JSON is refused by every module that reads JSON."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirror.errors import MirrorError
from mirror.ingest.rois import read_rois
from mirror.recordings.readers.folder import FolderReader
from mirror.schema.documents import DatasetDocument
from mirror.schema.files import parse_json, read_json
from mirror.schema.strict_json import JsonError, decode_json
from tests.builders.folder import write_recording

ROOT = Path(__file__).parents[2]
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)


@given(VALUES)
def test_valid_json_is_read_as_the_standard_library_reads_it(value: object) -> None:
    text = json.dumps(value)
    assert decode_json(text) == decode_json(text.encode(), constants=False) == json.loads(text) == value


@given(VALUES, VALUES, st.text(max_size=10))
def test_repeated_key_is_refused_at_any_depth(first: object, last: object, key: str) -> None:
    name = json.dumps(key)
    twice = f"{{{name}: {json.dumps(first)}, {name}: {json.dumps(last)}}}"
    for text in (twice, f"[1, {twice}]", f'{{"outer": {{"inner": [{twice}]}}}}'):
        with pytest.raises(JsonError, match="twice in one object"):
            decode_json(text)


@pytest.mark.parametrize("text", ["", "{", "[1,]", "{'a': 1}", "[" * 100_000, "1" * 5000, b"\xff\xfe\x00", "nul"])
def test_invalid_json_is_refused(text: str | bytes) -> None:
    with pytest.raises(JsonError, match="not valid JSON"):
        decode_json(text)


def test_nan_and_infinity_are_refused_on_request() -> None:
    assert decode_json("[Infinity]") == [float("inf")]
    with pytest.raises(JsonError, match="the number NaN"):
        decode_json("[NaN]", constants=False)


def test_documents_rois_and_recordings_with_a_repeated_key_are_refused(tmp_path: Path) -> None:
    (tmp_path / "dataset.json").write_text('{"format": "mirror", "format": "mirror"}')
    with pytest.raises(MirrorError, match=r"dataset\.json: .*'format'"):
        read_json(tmp_path / "dataset.json", DatasetDocument)
    with pytest.raises(MirrorError, match="the key 'a' stands twice"):
        parse_json(b'{"a": 1, "a": 2}', DatasetDocument, "dataset.json")
    rois = tmp_path / "rois.geojson"
    rois.write_text('{"type": "FeatureCollection", "features": [], "features": []}')
    with pytest.raises(MirrorError, match="the key 'features' stands twice"):
        read_rois(rois)
    write_recording(tmp_path, "twice")
    document = tmp_path / "twice" / "recording.json"
    document.write_text(document.read_text().replace("{", '{"drive_id": "another", ', 1))
    with pytest.raises(MirrorError, match="the key 'drive_id' stands twice"):
        FolderReader().open(tmp_path / "twice", {})


def test_no_module_reads_json_documents_in_another_way() -> None:
    own = {
        "mirror/schema/strict_json.py",
        # Lines of a log that only this toolkit writes; the last line may be incomplete.
        "mirror/evaluation/workers.py",
        # pip writes this file about the installation.
        "mirror/installation.py",
        # Values of a command line, and texts in safetensors files that the same module wrote.
        "baselines/hybridworldsim/methods/overrides.py",
        "baselines/hybridworldsim/methods/static.py",
        "baselines/hybridworldsim/model/storage.py",
        "baselines/hybridworldsim/training/run/checkpoint.py",
    }
    found = {
        str(path.relative_to(ROOT))
        for folder in ("mirror", "baselines", "leaderboard")
        for path in (ROOT / folder).rglob("*.py")
        if re.search(r"json\.loads?\(|model_validate_json|JSONDecoder", path.read_text())
    }
    assert found <= own
