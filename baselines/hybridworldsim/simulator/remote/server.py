"""Serves a `SensorService` over gRPC. Bytes that are no message, and requests that fail, are answered by a status."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Final

from hybridworldsim.simulator.remote.messages import SENSOR_SERVICE, wire
from hybridworldsim.simulator.remote.service import SensorService, TooManyError, UnknownSceneError
from mirror.errors import MirrorError, UsageError

_THREADS: Final = 4
_WAITING: Final = 64
_MAX_RECEIVED: Final = 8 << 20
_MAX_SENT: Final = 256 << 20
_GRACE_S: Final = 1.0


@contextmanager
def render_server(service: SensorService, host: str, port: int) -> Iterator[int]:
    """Run the sensor service while the block runs; yields the port.

    Args:
        service: answers the calls.
        host: address of an interface of this machine.
        port: the port; 0: a free one.

    Raises:
        UsageError: nobody can listen there.
    """
    import grpc

    server = grpc.server(
        ThreadPoolExecutor(_THREADS, "serve"),
        maximum_concurrent_rpcs=_WAITING,
        options=[
            ("grpc.max_receive_message_length", _MAX_RECEIVED),
            ("grpc.max_send_message_length", _MAX_SENT),
            ("grpc.so_reuseport", 0),
        ],
    )
    handlers = {name: _handler(message, call) for name, (message, call) in service.calls().items()}
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SENSOR_SERVICE, handlers),))
    try:
        bound = server.add_insecure_port(f"{host}:{port}")
    except RuntimeError as error:
        bound = 0
        problem: Exception | None = error
    else:
        problem = None
    if not bound:
        raise UsageError(
            f"nobody can listen at {host}:{port}", place="--host, --port", expected="a free port of this machine"
        ) from problem
    server.start()
    try:
        yield int(bound)
    finally:
        server.stop(_GRACE_S).wait(_GRACE_S)


def _handler(message: str, call: Callable[[Any], Any]) -> Any:
    import grpc
    from google.protobuf.message import DecodeError

    kind = getattr(wire(), message)

    def answer(data: bytes, context: Any) -> Any:
        try:
            return call(kind.FromString(data))
        except DecodeError:
            context.abort(grpc.StatusCode.INVALID_ARGUMENT, f"the bytes are no {message}")
        except UnknownSceneError as error:
            context.abort(grpc.StatusCode.NOT_FOUND, str(error))
        except UsageError as error:
            context.abort(grpc.StatusCode.INVALID_ARGUMENT, str(error))
        except TooManyError as error:
            context.abort(grpc.StatusCode.RESOURCE_EXHAUSTED, str(error))
        except MirrorError as error:
            context.abort(grpc.StatusCode.FAILED_PRECONDITION, str(error))

    # No deserializer: what cannot be parsed is answered by the method itself.
    return grpc.unary_unary_rpc_method_handler(answer, None, lambda reply: reply.SerializeToString())
