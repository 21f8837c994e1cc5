"""Addresses of the network that a verb listens on or connects to, checked before its work."""

from __future__ import annotations

import socket
from typing import Final

from mirror.errors import UsageError

LAST_PORT: Final = 65535


def require_listening(host: str, port: int) -> None:
    """Require that a server can listen on an interface of this machine; the port itself may be taken.

    Args:
        host: value of ``--host``: the name or number of an interface.
        port: value of ``--port``; 0: a free one.

    Raises:
        UsageError: no interface of this machine has the address, or no port has the number.
    """
    if not 0 <= port <= LAST_PORT:
        raise UsageError(
            f"{port}", place="--port", expected=f"a port: 0 to {LAST_PORT}; 0 takes a free one",
            remedy="give another number with --port",
        )  # fmt: skip
    try:
        for family, kind, protocol, _, address in socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM):
            with socket.socket(family, kind, protocol) as probe:
                probe.bind(address)
    except (OSError, UnicodeError) as error:
        raise UsageError(
            f"nobody can listen at {host!r}: {getattr(error, 'strerror', None) or error}", place="--host",
            expected="an address of this machine: 127.0.0.1 for this machine alone, 0.0.0.0 for others too",
            remedy="give such an address with --host",
        ) from error  # fmt: skip


def require_answer(host: str, port: int, *, place: str, timeout_s: float) -> None:
    """Require that a server accepts connections at an address.

    Args:
        host: name or number of a machine; an IPv6 number may stand in brackets.
        port: 1 to `LAST_PORT`.
        place: the option that gives the address.
        timeout_s: how long the connection may take.

    Raises:
        UsageError: nobody accepts it.
    """
    try:
        socket.create_connection((host.removeprefix("[").removesuffix("]"), port), timeout_s).close()
    except (OSError, UnicodeError) as error:
        raise UsageError(
            f"{host}:{port} does not answer: {getattr(error, 'strerror', None) or error}", place=place,
            expected="a running server", remedy=f"start it first, or give its address with {place}",
        ) from error  # fmt: skip
