"""The trigger runs as plain Python on small inputs whose machine code is not cached, and finds the same bits."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings

from mirror.ingest import clean, trigger
from mirror.ingest.clean import clean as clean_track
from mirror.ingest.trigger import RoiTrigger
from mirror.schema.documents import CleaningOptions, TriggerOptions
from tests.draws import draws
from tests.ingest.cases import Case, cases
from tests.plain_forms import compare_forms

_COMPILED = """
import json, sys
import numpy as np
from mirror.ingest.fix_status import count_backward
from mirror.ingest.metric import PLAIN_ELEMENTS
stamps = np.arange(PLAIN_ELEMENTS // 2 + 1)
found = []
for size in map(int, sys.argv[1:]):
    assert count_backward(stamps[:size]) == (0, -1)
    found.append(len(count_backward.overloads))
print(json.dumps(found))
"""


@seed(7)
@settings(
    max_examples=draws(60), deadline=None, database=None, phases=[Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip
@given(case=cases(["equator", "city", "arctic", "antimeridian", "plane"]))
def test_both_forms_of_the_trigger_give_the_same_bits(case: Case) -> None:
    with pytest.MonkeyPatch.context() as patch:
        calls = compare_forms(patch, clean, trigger)
        cleaning, options = CleaningOptions(), TriggerOptions()
        track, _ = clean_track(case.track, cleaning, min_step_m=options.min_step_m)
        for is_clip in (False, True):
            RoiTrigger(case.rois, options, cleaning).passes(track, frame=case.place.frame, is_clip=is_clip)
        assert calls


def compiled_after(cache: Path, *sizes: int) -> list[int]:
    """Return how many machine codes of a function a new process has after each call with inputs of these sizes."""
    done = subprocess.run(
        [sys.executable, "-c", _COMPILED, *map(str, sizes)], env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    found: list[int] = json.loads(done.stdout)
    return found


def test_a_function_is_compiled_once_its_inputs_are_large_and_loaded_where_it_was_compiled(tmp_path: Path) -> None:
    half = 50_001
    assert compiled_after(tmp_path, 10, half, half, 10) == [0, 0, 1, 1]
    assert compiled_after(tmp_path, 10) == [1]
