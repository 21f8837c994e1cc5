"""What AlpaSim's generated code makes of our messages, and the messages that it makes itself from the same numbers:
``python read.py FOLDER RESULT.json``."""

import base64
import json
import sys
from pathlib import Path

from alpasim_grpc.v0 import common_pb2, egodriver_pb2, sensorsim_pb2
from google.protobuf import json_format

folder, out = sys.argv[1:]
MODULES = (common_pb2, egodriver_pb2, sensorsim_pb2)


def walk(descriptor):
    yield descriptor
    for nested in descriptor.nested_types:
        yield from walk(nested)


def kind(field):
    of = field.message_type or field.enum_type
    return [field.number, field.type, field.label, of.full_name if of else ""]


messages, enums, services = {}, {}, {}
for module in MODULES:
    file = module.DESCRIPTOR
    for top in file.message_types_by_name.values():
        for descriptor in walk(top):
            messages[descriptor.full_name] = {field.name: kind(field) for field in descriptor.fields}
            for enum in descriptor.enum_types:
                enums[enum.full_name] = {value.name: value.number for value in enum.values}
    for enum in file.enum_types_by_name.values():
        enums[enum.full_name] = {value.name: value.number for value in enum.values}
    for service in file.services_by_name.values():
        services[service.full_name] = {
            method.name: [method.input_type.full_name, method.output_type.full_name] for method in service.methods
        }

classes = {name: getattr(module, name) for module in MODULES for name in module.DESCRIPTOR.message_types_by_name}
samples = []
for sample in json.loads((Path(folder) / "messages.json").read_text()):
    made = json_format.ParseDict(sample["fields"], classes[sample["message"]]())
    read = classes[sample["message"]].FromString(base64.b64decode(sample["bytes"]))
    samples.append(
        {
            "message": sample["message"],
            "fields": json_format.MessageToDict(read, preserving_proto_field_name=True),
            "bytes": base64.b64encode(made.SerializeToString(deterministic=True)).decode(),
        }
    )
result = {"messages": messages, "enums": enums, "services": services, "samples": samples}
Path(out).write_text(json.dumps(result, indent=0, sort_keys=True) + "\n")
