"""Fixtures shared by all tests."""

from __future__ import annotations

import fcntl
import gc
import os
import resource
import signal
import sys
from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

# Before torch is imported: test workers share the cores, and threads of several workers would wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Threads of torch that wait for a core would occupy another, in tests that set more than one.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import pytest
from hypothesis import settings

from tests.draws import PROFILE, draws

if TYPE_CHECKING:
    from mirror.dataset.dataset import Dataset
    from mirror.synth import SynthReport
    from tests.leaderboard.browser import Browser

# A shell ignores Ctrl-C for what it starts in the background; tests of interruptions need what Python does with it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The first example of a test may compile a kernel, and machines that run tests are loaded. The examples are the same in
# each run: one commit passes or fails, wherever it is tested. HYPOTHESIS_PROFILE=explore draws others.
settings.register_profile("mirror", deadline=None, derandomize=True, max_examples=draws(100))
settings.register_profile("whole", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None, max_examples=500, print_blob=True)
settings.load_profile(PROFILE)

ROOT = Path(__file__).resolve().parents[1]
CORE_SECONDS = "core_s"
ROOM_S = 45.0
"""What the tests of a room may take of a core (CONTRIBUTING.md)."""


# What the collection of tests imports and makes stays: searching it for garbage takes a quarter of its time.
gc.disable()


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop() -> None:
    """Leave all that was imported out of garbage collections, which would walk through it again and again."""
    global _reported_s
    gc.collect()
    gc.freeze()
    gc.enable()
    _reported_s = _processor_time_s()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files that need the synthetic street first: one of two workers makes it, and the other need not wait."""
    of_street = {"tiny_recordings", "tiny_dataset"}
    files = {item.path for item in items if of_street.intersection(getattr(item, "fixturenames", ()))}
    items.sort(key=lambda item: item.path not in files)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test marked `cuda` where no GPU can be used, with the reason; ``cuda(splats=True)`` also needs gsplat."""
    marker = item.get_closest_marker("cuda")
    if marker is None:
        return
    from mirror.devices import resolve_device
    from mirror.errors import UsageError

    try:
        resolve_device("cuda", splats=marker.kwargs.get("splats", False))
    except UsageError as error:
        pytest.skip(f"needs a GPU: {error.problem}")


def _processor_time_s() -> float:
    """Processor time of this process and of those that it started and that have ended."""
    used = [resource.getrusage(whose) for whose in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


_reported_s: float = 0.0


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Note in each report the processor time since the last one."""
    global _reported_s
    report = yield
    now = _processor_time_s()
    report.user_properties.append((CORE_SECONDS, now - _reported_s))
    _reported_s = now
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """List the rooms, folders of tests, that take more of the cores than a room may."""
    rooms: Counter[str] = Counter()
    for report in chain.from_iterable(terminalreporter.stats.values()):
        own = dict(getattr(report, "user_properties", ()))
        rooms["/".join(report.nodeid.split("/")[:2])] += own.get(CORE_SECONDS, 0.0) if own else 0.0
    costly = [f"{room} {seconds:.0f} s" for room, seconds in rooms.most_common() if seconds > ROOM_S]
    if costly:
        line = f"{sum(rooms.values()):.0f} s of processor time; more than {ROOM_S:.0f} s: {', '.join(costly)}"
        terminalreporter.write_line(line)


@pytest.fixture(autouse=True)
def one_thread_of_torch() -> Iterator[None]:
    """Undo the number of threads that a verb or a training run sets for its whole process."""
    yield
    torch = sys.modules.get("torch")
    if torch is not None and torch.get_num_threads() != 1:
        torch.set_num_threads(1)


@pytest.fixture(scope="session")
def started_browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A headless browser that starts once; tests use `browser`."""
    from tests.leaderboard.browser import NAMES, Browser, find_browser

    program = find_browser()
    if program is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)} is installed")
    started = Browser(program, tmp_path_factory.mktemp("profile"))
    yield started
    started.close()


@pytest.fixture
def browser(started_browser: Browser) -> Browser:
    """A headless browser with an empty page of its own size."""
    started_browser.call("Emulation.clearDeviceMetricsOverride")
    started_browser.call("Page.navigate", url="about:blank")
    return started_browser


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings; tests that need it skip where it is absent."""
    folder = Path(os.environ.get("MIRROR_REAL_DATA", ROOT.parent / "shared" / "data"))
    if not (folder / "README.md").is_file():
        pytest.skip(f"no real recordings at {folder}: set MIRROR_REAL_DATA")
    return folder


@contextmanager
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder that all workers of one run share, for one of them at a time."""
    folder = tmp_path_factory.getbasetemp()
    # The folder of a worker lies in that of the run.
    folder = (folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "shared"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield folder


@pytest.fixture(scope="session")
def tiny_recordings(tmp_path_factory: pytest.TempPathFactory) -> SynthReport:
    """The recordings of a synthetic street, written by two threads. Tests do not change them."""
    import mirror.synth

    with shared_folder(tmp_path_factory) as folder:
        # Complete recordings are kept.
        return mirror.synth.write_recordings(folder / "tiny", "tiny", 0, workers=2)


@pytest.fixture(scope="session")
def tiny_dataset(tiny_recordings: SynthReport, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two traversals of a synthetic street; split ``novel`` holds one of them out. Tests do not change it."""
    import mirror
    from mirror.dataset.splits import make_split
    from mirror.ingest.request import IngestOptions
    from mirror.ingest.rois import read_rois
    from mirror.ingest.run import ingest_recordings
    from mirror.schema.documents import NovelTraversal

    with shared_folder(tmp_path_factory) as folder:
        if not (folder / "dataset" / "splits" / "novel.json").exists():
            rois = read_rois(folder / "tiny" / "rois.geojson")
            assert not ingest_recordings(tiny_recordings.recordings, rois, folder / "dataset", IngestOptions()).failures
            make_split(folder / "dataset", "novel", NovelTraversal(train=1, held_out=1))
    return mirror.open(folder / "dataset")


@pytest.fixture(scope="session")
def generator_models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A generator and its autoencoder after one step each, whose images are noise, and ``clips`` of their training.

    It is trained with dropped layouts. Tests do not change it.
    """
    from hybridworldsim.generation.command import main
    from tests.generation.clips import write_clips

    with shared_folder(tmp_path_factory) as shared:
        folder = shared / "generator"
        if not (folder / "done").exists():
            clips = write_clips(folder / "clips", count=1)
            words = ["train", str(clips), "--steps", "1", "--autoencoder-steps", "1", "--batch", "1", "--json"]
            assert main([*words, "--drop-layout", "0.5", "--out", str(folder / "out")]) == 0
            (folder / "done").touch()
    return folder


@pytest.fixture(scope="session")
def made_street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of three lanes of one colour each (`tests/builders/lanes.py`); tests get copies of it."""
    from tests.builders.lanes import write_lanes

    return write_lanes(tmp_path_factory.mktemp("street") / "dataset")
