"""The page on which persons review a sample of redacted images: it is served on this machine and writes the log.

One image after the other is shown with the outlines of its regions. Keys: ``n`` next (nothing is missed), ``m`` miss,
``f`` false (a region shows neither face nor plate), ``b`` back, ``r`` regions on and off.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from pydantic import ValidationError

from mirror.dataset.layout import Layout, require_dataset
from mirror.dataset.redaction import REDACTION, newest_redaction
from mirror.dataset.store import Store
from mirror.dataset.taken_down import read_take_downs
from mirror.dataset.unfinished_work import DEIDENTIFICATION
from mirror.errors import DatasetError
from mirror.pages.rendering import read_script, render_page, script_data
from mirror.privacy.log import LOG, ImageRecord, Review, read_log
from mirror.privacy.release.sample import DEFAULT_SAMPLE, REVIEWS, ReviewedImage, choose_sample, read_reviews
from mirror.schema.files import read_table
from mirror.schema.json_lines import append_line
from mirror.schema.strict_json import decode_json
from mirror.schema.tables import IMAGES

_LONGEST: Final = 4096


class ReviewSession:
    """A sample of a dataset's redacted images and the reviewers' answers.

    Args:
        root: the dataset.
        reviewer: name or pseudonym of the person.
        sample: number of images.

    Attributes:
        sample: the images, in their order on the page.
        token: a secret that every request must carry, so that no other page can write the log.

    Raises:
        DatasetError: the dataset has no redacted images.
    """

    def __init__(self, root: Path, reviewer: str, sample: int = DEFAULT_SAMPLE) -> None:
        layout = Layout(root)
        require_dataset(layout)
        self._path = root / DEIDENTIFICATION / REVIEWS
        self._reviewer = reviewer
        self._store = Store(root)
        self._places: dict[str, tuple[str, int, int]] = {}
        records: list[ImageRecord] = []
        gone = {one.key for one in read_take_downs(self._store).images}
        for folder in sorted((root / "traversals").glob("*")):
            newest = newest_redaction(layout.layers(folder.name))
            if newest is None:
                continue
            layer = layout.layer(folder.name, REDACTION, *newest)
            records += [record for record in read_log(layer / LOG) if record.key not in gone]
            for row in read_table(layer / "images.parquet", IMAGES).to_pylist():
                self._places[row["sha256"].hex()] = row["uri"], row["byte_offset"], row["byte_length"]
        if not records:
            raise DatasetError(
                "no redacted images", file=root, expected="a dataset that was de-identified",
                remedy=f"mirror deidentify {root} --plate-region REGION",
            )  # fmt: skip
        self.sample: Sequence[ImageRecord] = choose_sample(records, sample)
        self.reviews: dict[str, Review] = read_reviews(self._path)
        self.token = secrets.token_urlsafe(16)

    @property
    def done(self) -> int:
        """Number of images of the sample that were reviewed."""
        return sum(record.out_sha256 in self.reviews for record in self.sample)

    def say(self, out_sha256: str, verdict: str) -> None:
        """Append a verdict to the log; the verdict is on disk on return.

        Raises:
            ValidationError: there is no such verdict.
            DatasetError: the disk is full.
        """
        reviewed = ReviewedImage(
            out_sha256=out_sha256, review=Review.model_validate({"verdict": verdict, "reviewer": self._reviewer})
        )
        append_line(self._path, reviewed.model_dump_json(), sync=True)
        self.reviews[out_sha256] = reviewed.review

    def image(self, out_sha256: str) -> bytes | None:
        """Return the bytes of an image of the sample; None if there is no such image."""
        known = {record.out_sha256 for record in self.sample}
        return self._store.read_range(*self._places[out_sha256]) if out_sha256 in known else None

    def page(self) -> str:
        """Render the page."""
        items = [
            {
                "sha256": record.out_sha256,
                "name": " / ".join(map(str, record.key)),
                "width": record.width_px,
                "height": record.height_px,
                "grow": record.grow,
                "regions": [[region.kind, *region.box_px] for region in record.regions],
                "verdict": self.reviews[record.out_sha256].verdict if record.out_sha256 in self.reviews else "",
            }
            for record in self.sample
        ]
        return render_page(
            "mirror.privacy.release",
            "review.html",
            title="Review of redacted images",
            data=script_data({"token": self.token, "items": items}),
            script=read_script("mirror.privacy.release", "review.js"),
        )


def review_server(session: ReviewSession, port: int = 0) -> ThreadingHTTPServer:
    """Return a server of the page on this machine only; ``serve_forever`` runs it.

    Args:
        session: the sample.
        port: port; 0: a free one.
    """
    return ThreadingHTTPServer(("127.0.0.1", port), partial(_Handler, session))


class _Handler(BaseHTTPRequestHandler):
    def __init__(self, session: ReviewSession, *args: Any) -> None:
        self._session = session
        super().__init__(*args)

    def do_GET(self) -> None:
        """Send the page or an image."""
        parts = urlsplit(self.path)
        if not self._is_allowed(parse_qs(parts.query)):
            return self._send(403, "text/plain", b"open the address that `mirror release review` printed")
        if parts.path == "/":
            return self._send(200, "text/html; charset=utf-8", self._session.page().encode())
        data = self._session.image(parts.path.removeprefix("/image/"))
        if data is None:
            return self._send(404, "text/plain", b"no such image")
        return self._send(200, "image/png" if data.startswith(b"\x89PNG") else "image/jpeg", data)

    def do_POST(self) -> None:
        """Write a verdict."""
        length = int(self.headers.get("Content-Length") or 0)
        try:
            said = decode_json(self.rfile.read(min(length, _LONGEST)))
            if not self._is_allowed({"token": [said["token"]]}):
                return self._send(403, "text/plain", b"another session")
            if self._session.image(said["sha256"]) is None:
                return self._send(404, "text/plain", b"no such image")
            self._session.say(said["sha256"], said["verdict"])
        except (ValueError, KeyError, TypeError, ValidationError) as error:
            return self._send(400, "text/plain", str(error).encode())
        return self._send(200, "text/plain", str(self._session.done).encode())

    def log_message(self, format: str, *args: Any) -> None:
        """Write nothing: the terminal is for the command."""

    def _is_allowed(self, query: Mapping[str, Sequence[str]]) -> bool:
        # A page of another site may send requests here, but does not know the token.
        host = (self.headers.get("Host") or "").rpartition(":")[0]
        return host in ("127.0.0.1", "localhost") and query.get("token", [""])[0] == self._session.token

    def _send(self, code: int, kind: str, data: bytes) -> None:
        self.send_response(code)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(data)
