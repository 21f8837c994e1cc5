"""The messages of the wire: classes made from ``protos/*.proto``, in a descriptor pool of their own.

``messages.binpb`` is the compiled form of these files (``protoc --descriptor_set_out``; a test compiles them again). A
pool of their own lets a program import AlpaSim's generated modules too: a message may be registered once in a pool.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from mirror.errors import UsageError
from mirror.installation import install_command

DRIVER_SERVICE: Final = "egodriver.EgodriverService"
SENSOR_SERVICE: Final = "nre.grpc.protos.sensorsim.SensorsimService"
API_VERSION: Final = 0, 54, 0
"""Version of AlpaSim's interface whose messages these are."""
_FILE: Final = "messages.binpb"


class Messages:
    """The message classes, as attributes; nested messages and enumeration values are attributes of the classes.

    Attributes:
        classes: the classes by name.
        image_formats: numbers of the image formats by name.
        shutters: numbers of the kinds of shutter by name.
    """

    def __init__(self) -> None:
        from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

        files = descriptor_pb2.FileDescriptorSet.FromString(Path(__file__).with_name(_FILE).read_bytes())
        pool = descriptor_pool.DescriptorPool()
        for file in files.file:
            pool.Add(file)
        self.classes: dict[str, Any] = {}
        for file in files.file:
            for message in file.message_type:
                descriptor = pool.FindMessageTypeByName(f"{file.package}.{message.name}")
                self.classes[message.name] = message_factory.GetMessageClass(descriptor)
        enum = pool.FindEnumTypeByName("nre.grpc.protos.sensorsim.ImageFormat")
        self.image_formats: dict[str, int] = {value.name: value.number for value in enum.values}
        shutters = pool.FindEnumTypeByName("nre.grpc.protos.sensorsim.ShutterType")
        self.shutters: dict[str, int] = {value.name: value.number for value in shutters.values}

    def __getattr__(self, name: str) -> Any:
        if name == "classes" or name not in self.classes:
            raise AttributeError(f"there is no message {name!r}")
        return self.classes[name]

    def version(self) -> Any:
        """Return the version of this program and of the interface."""
        from mirror.version import __version__

        major, minor, patch = API_VERSION
        api = self.VersionId.APIVersion(major=major, minor=minor, patch=patch)
        return self.VersionId(version_id=f"mirror-{__version__}", git_hash="unknown", grpc_api_version=api)


@lru_cache(maxsize=1)
def wire() -> Messages:
    """Return the classes of the messages.

    Raises:
        UsageError: gRPC or protobuf is not installed.
    """
    try:
        import grpc  # noqa: F401

        return Messages()
    except ModuleNotFoundError as error:
        raise UsageError(
            f"{error.name} is not installed", expected="the packages of the extra simulator",
            remedy=install_command("simulator"),
        ) from error  # fmt: skip
