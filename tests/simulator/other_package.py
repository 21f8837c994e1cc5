"""Imports MIRROR's messages beside another package with the same names: ``python -m tests.simulator.other_package``.

The other package does what modules that protoc generates do on import: it registers its files in protobuf's default
pool. Its files have the names of ours, and its messages have a field more. The first argument says who comes first.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from hybridworldsim.simulator.remote import messages

EXTRA = 90
"""Number of the field that only the other package has."""


def other_files() -> list[descriptor_pb2.FileDescriptorProto]:
    compiled = Path(messages.__file__).with_name("messages.binpb").read_bytes()
    files = list(descriptor_pb2.FileDescriptorSet.FromString(compiled).file)
    for file in files:
        for message in file.message_type:
            message.field.add(name="extra", number=EXTRA, type=5, label=1)
    return files


def import_other_package() -> dict[str, Any]:
    pool = descriptor_pool.Default()
    found = {}
    for file in other_files():
        pool.AddSerializedFile(file.SerializeToString())
        for message in file.message_type:
            name = f"{file.package}.{message.name}"
            found[message.name] = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
    return found


def main(first: str) -> None:
    if first == "mirror":
        ours = messages.wire()
        theirs = import_other_package()
    else:
        theirs = import_other_package()
        ours = messages.wire()
    assert set(ours.classes) == set(theirs)
    vector = theirs["Vec3"](x=1.0, y=2.0, z=3.0, extra=7)
    read = ours.Vec3.FromString(vector.SerializeToString())
    assert (read.x, read.y, read.z) == (1.0, 2.0, 3.0) and not hasattr(read, "extra")
    # A field that we do not know comes back unchanged.
    assert theirs["Vec3"].FromString(read.SerializeToString()) == vector
    request = ours.DriveRequest(time_now_us=5)
    assert theirs["DriveRequest"].FromString(request.SerializeToString()).time_now_us == 5
    # In one pool, the two would not get along.
    original = descriptor_pb2.FileDescriptorSet.FromString(
        Path(messages.__file__).with_name("messages.binpb").read_bytes()
    )
    try:
        descriptor_pool.Default().AddSerializedFile(original.file[0].SerializeToString())
    except TypeError:
        print("both")


if __name__ == "__main__":
    main(sys.argv[1])
