"""A server of S3 in this process: it keeps objects in memory, counts requests, and refuses as S3 documents it.

It is strict where S3 may be lenient: while a conditional put of a name is on its way, any other one of the same name is
answered with 409, and one that comes later with 412. The benchmarks use it too, with a delay a request.
"""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit
from xml.sax.saxutils import escape

BUCKET = "fleet"
PAGE = 1000
ENVIRONMENT = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}


@dataclass(frozen=True)
class Request:
    """One request that the server got.

    Attributes:
        method: GET, PUT ...
        key: of the object, without the bucket; empty: of the bucket.
        query: of the URL.
        headers: by lower-case name.
        status: that it was answered with.
        sent: bytes of the answer's body.
    """

    method: str
    key: str
    query: dict[str, str]
    headers: dict[str, str]
    status: int
    sent: int


@dataclass
class Bucket:
    """The contents of the server's only bucket.

    Attributes:
        objects: bytes by key.
        requests: in the order of their answers.
        delay_s: what each answer waits.
        hold_s: how long a conditional put keeps its name to itself.
        is_lenient: ignore ``If-None-Match`` and ``If-Match``, as some servers do.
        refusals: statuses that the next conditional requests get; 200: what they deserve.
    """

    objects: dict[str, bytes] = field(default_factory=dict)
    requests: list[Request] = field(default_factory=list)
    delay_s: float = 0.0
    hold_s: float = 0.0
    is_lenient: bool = False
    refusals: list[int] = field(default_factory=list)
    endpoint: str = ""
    parts: dict[str, dict[int, bytes]] = field(default_factory=dict)
    held: set[str] = field(default_factory=set)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def count(self, method: str = "") -> int:
        """The number of requests, of one method or of all."""
        return sum(request.method == method or not method for request in self.requests)


@contextmanager
def serving(bucket: Bucket | None = None) -> Iterator[Bucket]:
    """Serve a bucket at `Bucket.endpoint` on a free port of this machine."""
    served = bucket or Bucket()
    handler = type("Handler", (_Handler,), {"bucket": served})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    served.endpoint = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    try:
        yield served
    finally:
        server.shutdown()
        server.server_close()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    wbufsize = -1
    bucket: Bucket

    def log_message(self, *arguments: Any) -> None:
        pass

    def handle_expect_100(self) -> bool:
        self.send_response_only(100)
        self.end_headers()
        self.wfile.flush()
        return True

    def handle_one_request(self) -> None:
        try:
            super().handle_one_request()
        except ConnectionError:
            self.close_connection = True

    def do_GET(self) -> None:
        self._handle()

    do_PUT = do_POST = do_HEAD = do_DELETE = do_GET

    def _handle(self) -> None:
        url = urlsplit(self.path)
        query = {name: values[0] for name, values in parse_qs(url.query, keep_blank_values=True).items()}
        key = unquote(url.path).removeprefix(f"/{BUCKET}").lstrip("/")
        headers = {name.lower(): value for name, value in self.headers.items()}
        body = self._read(headers)
        if self.bucket.delay_s:
            time.sleep(self.bucket.delay_s)
        status, answer, more = self._answer(key, query, headers, body)
        sent = b"" if self.command == "HEAD" else answer
        self.bucket.requests.append(Request(self.command, key, query, headers, status, len(sent)))
        self.send_response(status)
        for name, value in {"Content-Length": str(len(answer)), **more}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(sent)
        self.wfile.flush()

    def _read(self, headers: dict[str, str]) -> bytes:
        body = self.rfile.read(int(headers.get("content-length", 0)))
        if "aws-chunked" not in headers.get("content-encoding", ""):
            return body
        data, at = b"", 0
        while (end := body.index(b"\r\n", at)) and (size := int(body[at:end].split(b";")[0], 16)):
            data += body[end + 2 : end + 2 + size]
            at = end + 4 + size
        return data

    def _answer(
        self, key: str, query: dict[str, str], headers: dict[str, str], body: bytes
    ) -> tuple[int, bytes, dict[str, str]]:
        if self.command == "PUT" and "uploadId" in query:
            self.bucket.parts[query["uploadId"]][int(query["partNumber"])] = body
            return 200, b"", {"ETag": _etag(body)}
        if self.command == "PUT":
            return self._put(key, headers, body, b"")
        if self.command == "POST" and "uploads" in query:
            upload = f"upload{len(self.bucket.parts)}"
            self.bucket.parts[upload] = {}
            return 200, _xml("InitiateMultipartUploadResult", UploadId=upload, Key=key, Bucket=BUCKET), {}
        if self.command == "POST" and "uploadId" in query:
            parts = self.bucket.parts[query["uploadId"]]
            whole = b"".join(parts[number] for number in sorted(parts))
            done = _xml("CompleteMultipartUploadResult", Key=key, Bucket=BUCKET, ETag=_etag(whole))
            return self._put(key, headers, whole, done)
        if self.command == "POST" and "delete" in query:
            for part in body.decode().split("<Key>")[1:]:
                self.bucket.objects.pop(part.partition("</Key>")[0], None)
            return 200, _xml("DeleteResult"), {}
        if self.command == "DELETE" and "uploadId" in query:
            self.bucket.parts[query["uploadId"]] = {}
            return 204, b"", {}
        if self.command == "DELETE":
            self.bucket.objects.pop(key, None)
            return 204, b"", {}
        if not key:
            return (200, self._list(query), {}) if self.command == "GET" else (200, b"", {})
        return self._get(key, headers)

    def _put(self, key: str, headers: dict[str, str], data: bytes, answer: bytes) -> tuple[int, bytes, dict[str, str]]:
        bucket = self.bucket
        if "if-match" in headers and not bucket.is_lenient:
            with bucket.lock:
                if key not in bucket.objects:
                    return 404, _xml("Error", Code="NoSuchKey", Message="no such key"), {}
                if _etag(bucket.objects[key]) != headers["if-match"]:
                    return _refusal(412)
                bucket.objects[key] = data
            return 200, answer, {"ETag": _etag(data)}
        if headers.get("if-none-match") != "*" or bucket.is_lenient:
            bucket.objects[key] = data
            return 200, answer, {"ETag": _etag(data)}
        with bucket.lock:
            refusal = bucket.refusals.pop(0) if bucket.refusals else 200
            if refusal != 200:
                return _refusal(refusal)
            if key in bucket.held:
                return _refusal(409)
            if key in bucket.objects:
                return _refusal(412)
            bucket.held.add(key)
        time.sleep(bucket.hold_s)
        with bucket.lock:
            bucket.objects[key] = data
            bucket.held.discard(key)
        return 200, answer, {"ETag": _etag(data)}

    def _get(self, key: str, headers: dict[str, str]) -> tuple[int, bytes, dict[str, str]]:
        data = self.bucket.objects.get(key)
        if data is None:
            return 404, b"" if self.command == "HEAD" else _xml("Error", Code="NoSuchKey", Message="no such key"), {}
        if headers.get("if-match", _etag(data)) != _etag(data):
            return (
                412,
                b"" if self.command == "HEAD" else _xml("Error", Code="PreconditionFailed", Message="changed"),
                {},
            )
        common = {"ETag": _etag(data), "Last-Modified": "Wed, 01 Jan 2025 00:00:00 GMT", "Accept-Ranges": "bytes"}
        if "range" not in headers:
            return 200, data, common
        first, _, last = headers["range"].removeprefix("bytes=").partition("-")
        start = int(first) if first else len(data) - int(last)
        end = min(int(last), len(data) - 1) if first and last else len(data) - 1
        if start >= len(data):
            return 416, _xml("Error", Code="InvalidRange", Message="beyond the end"), {}
        return 206, data[start : end + 1], {**common, "Content-Range": f"bytes {start}-{end}/{len(data)}"}

    def _list(self, query: dict[str, str]) -> bytes:
        prefix, delimiter = query.get("prefix", ""), query.get("delimiter", "")
        after = query.get("continuation-token") or query.get("start-after", "")
        size = min(int(query.get("max-keys", PAGE)), PAGE)
        found: dict[str, str] = {}
        for key in sorted(self.bucket.objects):
            if not key.startswith(prefix):
                continue
            head, cut, _ = key.removeprefix(prefix).partition(delimiter) if delimiter else (key, "", "")
            name = f"{prefix}{head}{delimiter}" if cut else key
            if name <= after or name in found:
                continue
            data = self.bucket.objects.get(key, b"")
            found[name] = (
                f"<CommonPrefixes><Prefix>{escape(name)}</Prefix></CommonPrefixes>"
                if cut
                else f"<Contents><Key>{escape(name)}</Key><Size>{len(data)}</Size><ETag>{_etag(data)}</ETag>"
                "<LastModified>2025-01-01T00:00:00.000Z</LastModified><StorageClass>STANDARD</StorageClass></Contents>"
            )
            if len(found) > size:
                break
        names = list(found)
        more = len(names) > size
        listed = names[:size]
        token = f"<NextContinuationToken>{escape(listed[-1])}</NextContinuationToken>" if more else ""
        text = "".join(found[name] for name in listed)
        return (
            f"<ListBucketResult><Name>{BUCKET}</Name><Prefix>{escape(prefix)}</Prefix><KeyCount>{len(listed)}</KeyCount>"
            f"<MaxKeys>{size}</MaxKeys><IsTruncated>{str(more).lower()}</IsTruncated>{token}{text}</ListBucketResult>"
        ).encode()


def _refusal(status: int) -> tuple[int, bytes, dict[str, str]]:
    code = {409: "ConditionalRequestConflict", 412: "PreconditionFailed", 403: "AccessDenied"}[status]
    more = {"Condition": "If-None-Match"} if status == 412 else {}
    return status, _xml("Error", Code=code, Message=f"refused with {status}", **more), {}


def _etag(data: bytes) -> str:
    # Hashing a whole object for each range of it would take longer than sending the range.
    some = data[:4096] + data[-4096:] + str(len(data)).encode()
    return f'"{hashlib.md5(some, usedforsecurity=False).hexdigest()}"'


def _xml(name: str, **values: str) -> bytes:
    inside = "".join(f"<{key}>{escape(value)}</{key}>" for key, value in values.items())
    return f'<?xml version="1.0" encoding="UTF-8"?><{name}>{inside}</{name}>'.encode()
