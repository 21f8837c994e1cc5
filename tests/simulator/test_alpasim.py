"""Our messages against AlpaSim's generated code: ``make peers`` writes what it made of them."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from typing import Any

import pytest
from google.protobuf import json_format

from hybridworldsim.simulator.remote.messages import DRIVER_SERVICE, SENSOR_SERVICE, wire
from hybridworldsim.simulator.remote.policy import DRIVER_CALLS
from tests.simulator.drivers import REQUESTS
from tests.simulator.peers import RESULT, sample_messages
from tests.simulator.served import CALLS as SENSOR_CALLS


@pytest.fixture(scope="module")
def theirs() -> Any:
    return json.loads(RESULT.read_text())


def walk(descriptor: Any) -> Iterator[Any]:
    yield descriptor
    for nested in descriptor.nested_types:
        yield from walk(nested)


def _is_repeated(field: Any) -> bool:
    """Return whether a field is repeated; protobuf 5 has the label alone, protobuf 7 the property alone."""
    return field.is_repeated if hasattr(field, "is_repeated") else field.label == field.LABEL_REPEATED


def ours() -> dict[str, Any]:
    return {
        descriptor.full_name: descriptor
        for message in wire().classes.values()
        for descriptor in walk(message.DESCRIPTOR)
    }


def test_every_field_of_every_message_has_their_name_number_and_type(theirs: Any) -> None:
    assert len(ours()) > 40
    for name, descriptor in ours().items():
        fields = {
            field.name: [
                field.number,
                field.type,
                3 if _is_repeated(field) else 1,
                getattr(field.message_type or field.enum_type, "full_name", ""),
            ]
            for field in descriptor.fields
        }
        assert fields == theirs["messages"][name], name
        for enum in descriptor.enum_types:
            assert {value.name: value.number for value in enum.values} == theirs["enums"][enum.full_name]
    assert wire().image_formats == theirs["enums"]["nre.grpc.protos.sensorsim.ImageFormat"]
    assert wire().shutters == theirs["enums"]["nre.grpc.protos.sensorsim.ShutterType"]


def test_the_calls_are_theirs(theirs: Any) -> None:
    def full(name: str) -> str:
        return wire().classes[name].DESCRIPTOR.full_name

    driver, sensor = theirs["services"][DRIVER_SERVICE], theirs["services"][SENSOR_SERVICE]
    assert {name: [full(REQUESTS[name]), full(answer)] for name, answer in DRIVER_CALLS.items()} == {
        name: driver[name] for name in DRIVER_CALLS
    }
    assert {name: [full(asked), full(answer)] for name, (asked, answer) in SENSOR_CALLS.items()} == {
        name: sensor[name] for name in SENSOR_CALLS
    }


def paths(fields: Any, before: str = "") -> set[str]:
    if isinstance(fields, list):
        return {path for value in fields for path in paths(value, before)}
    if not isinstance(fields, dict):
        return {before}
    return {path for name, value in fields.items() for path in paths(value, f"{before}.{name}")}


def test_their_code_reads_our_messages_and_makes_the_bytes_that_ours_makes(theirs: Any) -> None:
    messages = sample_messages()
    assert [message.DESCRIPTOR.name for message in messages] == [row["message"] for row in theirs["samples"]]
    assert {message.DESCRIPTOR.name for message in messages} >= {
        *REQUESTS.values(),
        "DriveResponse",
        "RGBRenderRequest",
    }
    for message, row in zip(messages, theirs["samples"], strict=True):
        made = json_format.ParseDict(row["fields"], type(message)())
        assert made.SerializeToString(deterministic=True) == base64.b64decode(row["bytes"]), row["message"]
        # They found every field in our bytes.
        assert paths(row["fields"]) == paths(json_format.MessageToDict(message, preserving_proto_field_name=True))
