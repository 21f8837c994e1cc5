"""Decoding JPEG and PNG images, one by one or several in parallel.

OpenCV is imported by the first decoding: most verbs open a dataset and decode nothing.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache

import numpy as np

from mirror.arrays import UInt8
from mirror.pools import usable_cores
from mirror.recordings.raster import has_end_marker, is_decodable


def decode_rgb(data: bytes, codec: str) -> UInt8 | None:
    """Decode a JPEG or PNG to pixels (H, W, 3), RGB, ignoring its EXIF orientation.

    Args:
        data: the encoded bytes.
        codec: ``jpeg`` or ``png``.

    Returns:
        The pixels; None: broken, cut short, or larger than any camera's raster.
    """
    import cv2

    if not is_decodable(data) or not has_end_marker(data, codec):
        return None
    flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    return None if pixels is None else np.asarray(pixels, np.uint8)


def decode_grey(data: bytes) -> UInt8 | None:
    """Decode a one-channel PNG to pixels (H, W); None if it is broken or larger than any camera's raster."""
    import cv2

    if not is_decodable(data):
        return None
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    return None if pixels is None else np.asarray(pixels, np.uint8)


def split_planes(pixels: UInt8, planes: UInt8) -> None:
    """Copy the channels of pixels (H, W, 3) into contiguous planes (3, H, W)."""
    import cv2

    cv2.mixChannels([pixels], [planes[0], planes[1], planes[2]], [0, 0, 1, 1, 2, 2])


def run_jobs(jobs: Sequence[Callable[[], None]], costs: Sequence[int], threads: int | None = None) -> None:
    """Run jobs on the cores of this process, the most expensive first, so that all threads end at about one time.

    Args:
        jobs: functions to call; the first error is raised when all jobs have ended.
        costs: (len(jobs),) relative cost of each job.
        threads: number of threads; None: one for each core; 1: only the calling thread.
    """
    count = usable_cores() if threads is None else threads
    order = sorted(range(len(jobs)), key=lambda index: -costs[index])
    if count == 1 or len(jobs) == 1:
        for index in order:
            jobs[index]()
        return
    futures = [_pool(os.getpid(), count).submit(jobs[index]) for index in order]
    wait(futures)
    for future in futures:
        future.result()


_pool_lock = threading.Lock()


@cache
def _cached_pool(process: int, threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="mirror-decode")


def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    # One pool for each process: a forked child would inherit a pool without its threads.
    with _pool_lock:
        return _cached_pool(process, threads)
