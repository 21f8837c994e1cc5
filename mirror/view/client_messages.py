"""Checks the messages of a page before viser reads them: what one page sends never stops the viewer for the others."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeGuard

_MAX_PX: Final = 16_384
_MAX_ASPECT: Final = 10.0
_MIN_FOV_RAD: Final = math.radians(1.0)
_MAX_FOV_RAD: Final = math.radians(170.0)
_MAX_COORDINATE_M: Final = 1e6
_MAX_CONTROL: Final = 1e6
_MAX_TEXT: Final = 256


@dataclass(frozen=True)
class MessageProblem:
    """The reason why a message is not read.

    Attributes:
        text: what is wrong with it.
        fatal: the bytes are no message at all; the connection is closed.
    """

    text: str
    fatal: bool = False

    def __str__(self) -> str:
        return self.text


def find_problem(data: object) -> MessageProblem | None:
    """Find the reason why a message of a page is not read; None if it is valid.

    Messages of kinds that the page of the viewer does not need are not read either, such as the one with which viser
    opens a public tunnel.

    Args:
        data: what the socket received: bytes of one message of viser's protocol.
    """
    import msgspec

    if not isinstance(data, bytes):
        return MessageProblem("text in place of bytes", fatal=True)
    try:
        message = msgspec.msgpack.decode(data)
    except (msgspec.MsgspecError, RecursionError, ValueError):
        return MessageProblem("the bytes are no message", fatal=True)
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        return MessageProblem("a message without a type", fatal=True)
    check = _CHECKS.get(message["type"])
    if check is None:
        return MessageProblem(f"messages of type {message['type'][:_MAX_TEXT]} are not read")
    text = check(message)
    return None if text is None else MessageProblem(text)


def _find_camera_problem(message: Mapping[str, Any]) -> str | None:
    lengths = {"wxyz": 4, "position": 3, "look_at": 3, "up_direction": 3}
    for name, length in lengths.items():
        vector = message.get(name)
        if not _is_vector(vector, length):
            return f"{name} is not {length} finite numbers of at most {_MAX_COORDINATE_M:g}"
    if math.hypot(*message["wxyz"]) < 0.5:
        return "wxyz is no rotation"
    for name in ("fov", "near", "far"):
        if not _is_number(message.get(name)):
            return f"{name} is not a finite number"
    if not _MIN_FOV_RAD <= message["fov"] <= _MAX_FOV_RAD:
        return f"fov is {message['fov']:g} rad, not {_MIN_FOV_RAD:.3f} to {_MAX_FOV_RAD:.3f}"
    width, height = message.get("image_width"), message.get("image_height")
    if not (_is_number(width) and _is_number(height) and min(width, height) >= 1 and max(width, height) <= _MAX_PX):
        return f"an image whose sides are not 1 to {_MAX_PX} pixels"
    if not 1.0 / _MAX_ASPECT <= width / height <= _MAX_ASPECT:
        return f"an image of {width} x {height} pixels, more than {_MAX_ASPECT:g} times as long in one direction"
    return None


def _find_control_problem(message: Mapping[str, Any]) -> str | None:
    updates = message.get("updates")
    if not isinstance(message.get("uuid"), str):
        return "a control without an id"
    # viser sets every attribute that is named here.
    if not isinstance(updates, dict) or set(updates) != {"value"}:
        return "a control whose value alone may change"
    value = updates["value"]
    if isinstance(value, bool) or (isinstance(value, str) and len(value) <= _MAX_TEXT):
        return None
    return None if _is_number(value) and abs(value) <= _MAX_CONTROL else "a control whose value is out of range"


def _find_download_problem(message: Mapping[str, Any]) -> str | None:
    """Check the receipt for a part of a file, such as a screenshot."""
    counts = [message.get("transferred_bytes"), message.get("total_bytes")]
    return None if all(_is_number(count) for count in counts) else "a receipt without numbers"


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_vector(value: object, length: int) -> bool:
    if not isinstance(value, Sequence) or isinstance(value, str | bytes) or len(value) != length:
        return False
    return all(_is_number(number) and abs(number) <= _MAX_COORDINATE_M for number in value)


_CHECKS: Final[Mapping[str, Callable[[Mapping[str, Any]], str | None]]] = {
    "ViewerCameraMessage": _find_camera_problem,
    "GuiUpdateMessage": _find_control_problem,
    "FileTransferPartAck": _find_download_problem,
}
