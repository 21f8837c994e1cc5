"""Work in parts: all of it, once each, whatever fails or is nested."""

import threading

import numba
import numpy as np
import pytest
import torch

from hybridworldsim.kernels.threads import in_parallel, in_row_spans


@pytest.fixture(params=[1, 2, 4])
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


@pytest.mark.parametrize("parts", [0, 1, 2, 33])
def test_each_part_is_called_once(threads, parts):
    called, lock = [], threading.Lock()

    def call(part):
        with lock:
            called.append(part)

    in_parallel(call, parts)
    assert sorted(called) == list(range(parts))


@pytest.mark.parametrize("rows", [0, 1, 47, 48, 1001])
@pytest.mark.parametrize("threads", [1, 3])
def test_spans_of_rows_cover_each_row_once(monkeypatch, threads, rows):
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", threads)
    covered = np.zeros(rows, np.int64)

    def call(begin, end):
        covered[begin:end] += 1

    in_row_spans(call, rows)
    assert (covered == 1).all()


def test_parts_within_parts_do_not_wait_for_each_other(threads):
    called, lock = [], threading.Lock()

    def inner(part):
        with lock:
            called.append(part)

    in_parallel(lambda _: in_parallel(inner, 4), 5)
    assert sorted(called) == sorted(list(range(4)) * 5)


def test_inner_parts_of_the_calling_thread_do_not_wait_for_outer_parts_of_others(threads):
    if threads < 2:
        pytest.skip("needs two threads")
    finished, met = [threading.Event(), threading.Event()], []

    def outer(part):
        in_parallel(lambda _: None, 4)
        finished[part].set()
        met.append(finished[1 - part].wait(10.0))

    in_parallel(outer, 2)
    assert met == [True, True]


def test_a_failure_is_raised_when_nothing_is_written_any_more(threads):
    running, lock = [0], threading.Lock()

    def call(part):
        with lock:
            running[0] += 1
        try:
            if part == 3:
                raise ValueError("part 3")
        finally:
            with lock:
                running[0] -= 1

    with pytest.raises(ValueError, match="part 3"):
        in_parallel(call, 1000)
    assert running == [0]
