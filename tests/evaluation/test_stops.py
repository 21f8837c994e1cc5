"""Ctrl-C and SIGTERM at random instants: exit code 130 within five seconds, no traceback, a run that continues."""

from __future__ import annotations

import signal
import sys
import time
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path

import pytest

from mirror.dataset.dataset import Dataset
from mirror.evaluation.run import EvaluationOptions, evaluate
from tests.builders.folder import tree
from tests.evaluation.submissions import SPLIT, small, small_text, write_renders
from tests.interruption import MOST_S, SIGNALS, finish, interrupt, stop_thrice
from tests.processes import NEVER_S, Running

SAYS = "held: interrupted: run the same command again\n"


def has_lines(path: Path, count: float) -> bool:
    return (path.read_bytes().count(b"\n") if path.exists() else 0) >= count


def test_evaluate_stops_and_continues(dataset: Dataset, root: Path, tmp_path: Path) -> None:
    renders, stopped, hits = tmp_path / "renders", tmp_path / "stopped", 0
    plan = write_renders(dataset, small(every=1), renders)
    (tmp_path / "small.toml").write_text(small_text(every=1))
    assert evaluate(renders, root, small(every=1), SPLIT, tmp_path / "whole", EvaluationOptions(workers=1)).result
    words = ["evaluate", root, renders, "--protocol", tmp_path / "small.toml", "--workers", "2", "--out", stopped]
    # While the workers start, and after some of the images. SIGKILL cannot be heard; the workers end nevertheless.
    for share, number, group in zip((0.0, 0.1, 0.2, 0.4), *zip((signal.SIGKILL, False), *SIGNALS)):
        lines = share * len(plan.views)
        once = partial(has_lines, stopped / "work" / "scored.jsonl", lines)
        ended = interrupt(words, 0.0, number, group=group, once=once)
        hits += ended.hit
        if ended.hit and number == signal.SIGKILL:
            assert (ended.code, ended.taken_s < MOST_S) == (-signal.SIGKILL, True), ended
        elif ended.hit:
            ended.require_stopped()
    assert hits >= 2
    finish(words)
    for name in ("result.json", "images.parquet"):
        assert (stopped / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_synth_stops_and_continues(root: Path, tmp_path: Path) -> None:
    words = ["synth", "--preset", "tiny", "--traversals", "1", "--out", tmp_path / "tiny"]
    stop_thrice(words, 2.0, seed=55)
    finish(words)
    # The other drives are others where there is one traversal.
    written, whole = tree(tmp_path / "tiny"), tree(root.parent / "tiny")
    same = [name for name in whole if name.startswith(("guangzhou-urban-01/", "maps/", "rois.geojson"))]
    assert len(same) > 100 and [written[name] for name in same] == [whole[name] for name in same]


@pytest.mark.parametrize(
    ("after_s", "verb"),
    [(0.0, "reconstruct"), (0.02, "baseline"), (0.1, "reconstruct"), (0.3, "baseline"), (0.8, "reconstruct")],
)
def test_stop_during_the_start(after_s: float, verb: str, root: Path, tmp_path: Path) -> None:
    """The command imports its libraries then."""
    more = {"reconstruct": ["--steps", "100000"], "baseline": ["--method", "nearest_frame"]}[verb]
    ended = interrupt([verb, root, "--split", SPLIT, "--out", tmp_path / "out", *more], after_s, imports=True)
    if verb == "reconstruct" or ended.hit:
        ended.require_stopped()


def hold(work_s: str) -> None:
    """Be a command that goes on although it is interrupted."""
    from mirror.command import run_command
    from mirror.stops import run_process

    def work() -> int:
        while True:
            with suppress(KeyboardInterrupt):
                print("working", flush=True)
                time.sleep(float(work_s))

    sys.exit(run_process("held", lambda: run_command("held", work)))


def test_second_signal_ends_the_process_at_once() -> None:
    for signals, least_s, most_s in ((1, 2.0, MOST_S), (2, 0.0, 1.0)):
        with Running(hold, str(NEVER_S)) as running:
            assert running.stdout.readline() == b"working\n"
            since = time.monotonic()
            for _ in range(signals):
                running.send(signal.SIGINT)
                time.sleep(0.1)
            assert running.wait() == 130
            assert least_s < time.monotonic() - since < most_s
            assert running.stderr.read().decode() == f"begun\n{SAYS}"


def save(file: str) -> None:
    """Be a command that saves a checkpoint for four seconds once it is interrupted."""
    from hybridworldsim.training.run.interruption import interruptible
    from mirror.command import run_command
    from mirror.stops import run_process

    def work() -> int:
        with interruptible() as interrupted:
            print("working", flush=True)
            interrupted.wait(NEVER_S)
            time.sleep(4.0)
            Path(file).write_text("saved")
            raise KeyboardInterrupt

    sys.exit(run_process("held", lambda: run_command("held", work)))


def test_a_checkpoint_may_take_longer_than_a_command_is_given_to_end(tmp_path: Path) -> None:
    # A scheduler's SIGTERM is one signal, although it is heard as Ctrl-C.
    cases = ((signal.SIGINT, 1, True), (signal.SIGINT, 2, False), (signal.SIGTERM, 1, True))
    files = [tmp_path / f"{number}-{signals}" for number, signals, _ in cases]
    with ExitStack() as stack:
        processes = [stack.enter_context(Running(save, file)) for file in files]
        for running, (number, signals, _) in zip(processes, cases):
            assert running.stdout.readline() == b"working\n"
            for _ in range(signals):
                running.send(number)
                time.sleep(0.3)
        for running, file, (_, _, saved) in zip(processes, files, cases):
            assert (running.wait(), file.exists()) == (130, saved)
            assert running.stderr.read().decode() == f"begun\n{SAYS}"
