"""Buckets for tests: a server of this process, and the environment by which the toolkit finds it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tests.builders.bucket import BUCKET, ENVIRONMENT, Bucket, serving


@contextmanager
def reached_by_environment(endpoint: str) -> Iterator[None]:
    """Let the toolkit reach a server of S3; its connections are closed before and after."""
    s3fs = pytest.importorskip("s3fs", reason="needs s3fs, of the extra s3")
    before = dict(os.environ)
    os.environ.update({**ENVIRONMENT, "AWS_ENDPOINT_URL": endpoint, "AWS_EC2_METADATA_DISABLED": "true"})
    s3fs.S3FileSystem.clear_instance_cache()
    try:
        yield
    finally:
        s3fs.S3FileSystem.clear_instance_cache()
        os.environ.clear()
        os.environ.update(before)


@contextmanager
def served_bucket() -> Iterator[Bucket]:
    """Serve an empty bucket and let the toolkit reach it."""
    with serving() as bucket, reached_by_environment(bucket.endpoint):
        yield bucket


@contextmanager
def moto_bucket() -> Iterator[None]:
    """Serve an empty bucket by another implementation of S3, moto, and let the toolkit reach it."""
    moto_server = pytest.importorskip("moto.server", reason="needs moto[s3], flask and flask-cors")
    from moto.backends import get_backend

    server = moto_server.ThreadedMotoServer(port=0, verbose=False)
    server.start()
    try:
        # Servers of one process share their buckets.
        get_backend("s3").reset()
        host, port = server.get_host_and_port()
        with reached_by_environment(f"http://{host}:{port}"):
            import s3fs

            s3fs.S3FileSystem().mkdir(BUCKET)
            yield
    finally:
        server.stop()
