"""Ctrl-C and SIGTERM at random instants: exit code 130 within five seconds, no traceback, a run that continues."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mirror.dataset.dataset import Dataset
from tests.builders.folder import tree
from tests.evaluation.submissions import SPLIT, small, small_text, write_renders
from tests.interruptions import MIRROR, MOST_S, finish, hear_again, interrupt, stop_thrice


@pytest.fixture(scope="module")
def renders(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stops") / "renders"
    write_renders(dataset, small(every=1, width=240), folder)
    return folder


def test_evaluate_stops_and_continues(renders: Path, root: Path, tmp_path: Path) -> None:
    protocol = tmp_path / "small.toml"
    protocol.write_text(small_text(every=1, width=240))
    words = [*MIRROR, "evaluate", root, renders, "--protocol", protocol, "--workers", "2", "--out"]
    whole_s = finish([*words, tmp_path / "whole"])
    stop_thrice([*words, tmp_path / "stopped"], 0.9 * whole_s, seed=1)
    # SIGKILL cannot be handled; the workers end nevertheless.
    killed = interrupt([*words, tmp_path / "killed"], 0.4 * whole_s, signal.SIGKILL, group=False)
    assert not killed.hit or (killed.code == -signal.SIGKILL and killed.taken_s < MOST_S), killed
    finish([*words, tmp_path / "stopped"])
    for name in ("result.json", "images.parquet"):
        assert (tmp_path / "stopped" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_synth_stops_and_continues(root: Path, tmp_path: Path) -> None:
    words = [*MIRROR, "synth", "--preset", "tiny", "--traversals", "1", "--out", tmp_path / "tiny"]
    stop_thrice(words, 4.0, seed=55)
    finish(words)
    # The other drives are others where there is one traversal.
    written, whole = tree(tmp_path / "tiny"), tree(root.parent / "tiny")
    same = [name for name in whole if name.startswith(("guangzhou-urban-01/", "maps/", "rois.geojson"))]
    assert len(same) > 100 and [written[name] for name in same] == [whole[name] for name in same]


def test_ingest_and_rois_stop_and_continue(root: Path, tmp_path: Path) -> None:
    # Beside the recordings lie their maps, ROIs and document.
    recordings = sorted(path for path in (root.parent / "tiny").iterdir() if (path / "recording.json").is_file())
    rois = root.parent / "tiny" / "rois.geojson"
    words = [*MIRROR, "ingest", *recordings, "--rois", rois, "--out"]
    whole_s = finish([*words, tmp_path / "whole"])
    stop_thrice([*words, tmp_path / "stopped"], 0.9 * whole_s, seed=3)
    finish([*words, tmp_path / "stopped"])
    assert tree(tmp_path / "stopped") == tree(tmp_path / "whole")
    stop_thrice([*MIRROR, "rois", "propose", *recordings, "--min-traversals", "1"], 0.8 * whole_s, seed=4)


@pytest.mark.parametrize("after_s", [0.0, 0.02, 0.1, 0.3, 0.6, 1.2])
def test_stop_during_the_start(after_s: float, root: Path, tmp_path: Path) -> None:
    words = [*MIRROR, "reconstruct", root, "--split", SPLIT, "--steps", "100000", "--out", tmp_path / "model"]
    interrupt(words, after_s).require_stopped()
    words = [*MIRROR, "baseline", root, "--method", "nearest_frame", "--split", SPLIT, "--out", tmp_path / "renders"]
    ended = interrupt(words, after_s)
    if ended.hit:
        ended.require_stopped()


def test_second_signal_ends_the_process_at_once() -> None:
    held = (
        "import sys, time\n"
        "from mirror.command import run_command\n"
        "from mirror.stops import run_process\n"
        "def work():\n"
        "    while True:\n"
        "        try:\n"
        "            print('working', flush=True)\n"
        "            time.sleep(60)\n"
        "        except KeyboardInterrupt:\n"
        "            pass\n"
        "sys.exit(run_process('held', lambda: run_command('held', work)))\n"
    )
    for signals, least_s, most_s in ((1, 2.0, 5.0), (2, 0.0, 1.0)):
        running = subprocess.Popen(
            [sys.executable, "-c", held], stdout=subprocess.PIPE, stderr=subprocess.PIPE, preexec_fn=hear_again
        )
        assert running.stdout is not None and running.stdout.readline() == b"working\n"
        since = time.monotonic()
        for _ in range(signals):
            running.send_signal(signal.SIGINT)
            time.sleep(0.1)
        _, stderr = running.communicate(timeout=20.0)
        assert least_s < time.monotonic() - since < most_s
        assert running.returncode == 130
        assert stderr == b"held: interrupted: run the same command again\n"


def test_a_checkpoint_may_take_longer_than_a_command_is_given_to_end(tmp_path: Path) -> None:
    held = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from hybridworldsim.training.run.interruption import interruptible\n"
        "from mirror.command import run_command\n"
        "from mirror.stops import run_process\n"
        "def work():\n"
        "    with interruptible() as interrupted:\n"
        "        print('working', flush=True)\n"
        "        interrupted.wait(60)\n"
        "        time.sleep(4.0)\n"
        "        Path(sys.argv[1]).write_text('saved')\n"
        "        raise KeyboardInterrupt\n"
        "sys.exit(run_process('held', lambda: run_command('held', work)))\n"
    )
    # A scheduler's SIGTERM is one signal, although it is heard as Ctrl-C.
    cases = ((signal.SIGINT, 1, True), (signal.SIGINT, 2, False), (signal.SIGTERM, 1, True))
    files = [tmp_path / f"{number}-{signals}" for number, signals, _ in cases]
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", held, file], stdout=subprocess.PIPE, stderr=subprocess.PIPE, preexec_fn=hear_again
        )
        for file in files
    ]
    for running, (number, signals, _) in zip(processes, cases):
        assert running.stdout is not None and running.stdout.readline() == b"working\n"
        for _ in range(signals):
            running.send_signal(number)
            time.sleep(0.3)
    for running, file, (_, _, saved) in zip(processes, files, cases):
        _, stderr = running.communicate(timeout=30.0)
        assert (file.exists(), running.returncode) == (saved, 130)
        assert stderr == b"held: interrupted: run the same command again\n"
