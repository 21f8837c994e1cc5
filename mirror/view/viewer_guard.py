"""Guards the socket of viser's server: its own page, opened with the viewer's token, may connect, and no other page.

A browser lets every web page open a WebSocket to every address, and viser answers all of them (OWASP: cross-site
WebSocket hijacking). Therefore three things are checked before viser sees a request: the name under which the server
was addressed (against DNS rebinding), a token in a cookie that other sites cannot send, and the origin of the page.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import parse_qs, urlsplit

from mirror.errors import UsageError
from mirror.installation import install_command
from mirror.view.client_messages import find_problem

if TYPE_CHECKING:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

_TOKEN_BYTES: Final = 24
_MAX_MESSAGE: Final = 1 << 20
_POLICY_VIOLATION: Final = 1008
_PATCHING: Final = threading.Lock()


class ViewerGuard:
    """A guard that decides which requests reach the viewer.

    Args:
        host: address that the server listens on.

    Attributes:
        token: secret of this viewer, which the address of its page has.
    """

    def __init__(self, host: str) -> None:
        self.token = secrets.token_urlsafe(_TOKEN_BYTES)
        self._is_local = _is_loopback(host)

    def url(self, host: str, port: int) -> str:
        """Return the address of the page, with the token."""
        return f"http://{f'[{host}]' if ':' in host else host}:{port}/?token={self.token}"

    def find_fault(self, path: str, headers: Headers, port: int) -> str | None:
        """Find the reason why a request is refused; None if it may pass.

        Args:
            path: path and query of the request.
            headers: headers of the request.
            port: port that the request came to.
        """
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_own_name(hosts[0], port):
            return "the server has another name"
        if not self._has_token(path, headers, port):
            return "the token is missing or wrong: open the address that `mirror view` printed"
        is_socket = any("websocket" in value.lower() for value in headers.get_all("Upgrade"))
        own = {f"{scheme}://{hosts[0].lower()}" for scheme in ("http", "https")}
        if is_socket and not (len(origins) == 1 and origins[0].lower() in own):
            return "the request comes from another page"
        return None

    def answer(self, path: str, headers: Headers, port: int) -> Response | None:
        """Answer a request that viser may not see; None for a request that viser answers.

        The address with the token is answered by a cookie and the address without it, so that the token stands in no
        history and in no link.
        """
        fault = self.find_fault(path, headers, port)
        if fault is not None:
            return _response(HTTPStatus.FORBIDDEN, fault)
        if "token" not in parse_qs(urlsplit(path).query):
            return None
        cookie = f"{_cookie_name(port)}={self.token}; Path=/; HttpOnly; SameSite=Strict"
        return _response(HTTPStatus.SEE_OTHER, "", {"Location": "/", "Set-Cookie": cookie})

    def _is_own_name(self, host: str, port: int) -> bool:
        try:
            parts = urlsplit(f"//{host}")
            name, asked = parts.hostname, parts.port
        except ValueError:
            return False
        if name is None or (asked or 80) != port:
            return False
        # On an address of the network the names are not known; the token is a secret of one name there.
        return not self._is_local or name == "localhost" or _is_loopback(name)

    def _has_token(self, path: str, headers: Headers, port: int) -> bool:
        given = parse_qs(urlsplit(path).query).get("token", [])
        for text in headers.get_all("Cookie"):
            try:
                cookie = SimpleCookie(text).get(_cookie_name(port))
            except CookieError:
                continue
            given += [] if cookie is None else [cookie.value]
        return any(hmac.compare_digest(one.encode(), self.token.encode()) for one in given)


@contextmanager
def guarded_sockets(guard: ViewerGuard) -> Iterator[None]:
    """Guard the server that viser starts within the block.

    viser has no option for it: the function of websockets with which it opens its socket is replaced for that time.

    Raises:
        UsageError: viser did not open its socket with that function; whatever it opened is not guarded.
    """
    import websockets.asyncio.server as server

    plain, opened = server.serve, threading.Event()

    class CheckedConnection(server.ServerConnection):
        """A connection on which only valid messages of the page are received."""

        dropped = 0

        async def recv(self, *arguments: Any, **options: Any) -> Any:
            while True:
                data = await super().recv(*arguments, **options)
                problem = find_problem(data)
                if problem is None:
                    return data
                self.dropped += 1
                if self.dropped == 1:
                    self.logger.warning("messages of %s are dropped; the first: %s", self.remote_address, problem)
                if problem.fatal:
                    await self.close(_POLICY_VIOLATION, problem.text)

    def serve(handler: Any, *arguments: Any, process_request: Any = None, **options: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            refused = guard.answer(request.path, request.headers, connection.local_address[1])
            if refused is not None or process_request is None:
                return refused
            return process_request(connection, request)

        opened.set()
        options |= {"process_request": check, "max_size": _MAX_MESSAGE, "create_connection": CheckedConnection}
        return plain(handler, *arguments, **options)

    with _PATCHING:
        server.serve = serve  # type: ignore[assignment,misc]
        try:
            yield
        finally:
            server.serve = plain  # type: ignore[misc]
    if not opened.is_set():
        raise UsageError("this version of viser opens its socket in an unknown way", remedy=install_command("view"))


def _cookie_name(port: int) -> str:
    """Name of the cookie; browsers send cookies to all ports of a name."""
    return f"mirror_view_{port}"


def _is_loopback(host: str) -> bool:
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _response(status: HTTPStatus, text: str, more: dict[str, str] | None = None) -> Response:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    body = text.encode()
    headers = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body)), "Connection": "close"}
    return Response(status, status.phrase, Headers({**headers, **(more or {})}), body)
