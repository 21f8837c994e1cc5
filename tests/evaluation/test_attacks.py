"""Attacks of a hostile participant on the score, each with its figure before and after (docs/threat-model.md)."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.evaluation.run import EvaluationOptions, evaluate
from mirror.evaluation.submission.check import check_submission
from mirror.evaluation.submission.manifest import MANIFEST, Appearance
from mirror.evaluation.submission.untrusted import open_untrusted
from mirror.progress import NullProgress
from mirror.protocols.document import load_protocol
from mirror.protocols.png import encode_png
from mirror.protocols.views import RenderView, plan_views
from tests.evaluation.submissions import LEFT_HALF, SPLIT, small, write_renders

ALONE = EvaluationOptions(workers=1)
GROUPS = '[[groups]]\nname = "training"\nroles = ["train"]\n\n[[groups]]\nname = "novel"\nroles = ["held_out"]\n'


def test_choosing_the_scored_pixels_is_refused(root: Path, dataset: Dataset, tmp_path: Path) -> None:
    """Before: PSNR* 20.81 dB became 38.45 by naming all but the sky as fitted. After: the key does not exist."""
    protocol = small(more=LEFT_HALF)
    write_renders(dataset, protocol, tmp_path / "s", appearance=Appearance(policy="fitted"))
    manifest = json.loads((tmp_path / "s" / MANIFEST).read_text())
    manifest["appearance"]["held_out_pixels"] = [{"left": 0, "top": 0, "right": 1, "bottom": 0.9}]
    (tmp_path / "s" / MANIFEST).write_text(json.dumps(manifest))
    done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    assert done.result is None
    assert "held_out_pixels" in done.check.problems[0].message


def test_fitted_appearance_is_scored_on_the_other_half_in_every_group(
    root: Path, dataset: Dataset, tmp_path: Path
) -> None:
    def left_is_perfect(view: RenderView, truth: UInt8) -> UInt8:
        middle = math.ceil(truth.shape[1] / 2)
        return np.concatenate([truth[:, :middle], truth[:, middle:] // 2], axis=1)

    def right_is_perfect(view: RenderView, truth: UInt8) -> UInt8:
        middle = math.ceil(truth.shape[1] / 2)
        return np.concatenate([truth[:, :middle] // 2, truth[:, middle:]], axis=1)

    found = {}
    protocol = small(more=LEFT_HALF, groups=GROUPS)
    for name, change in (("left", left_is_perfect), ("right", right_is_perfect)):
        write_renders(dataset, protocol, tmp_path / name, change, appearance=Appearance(policy="fitted"))
        done = evaluate(tmp_path / name, root, protocol, SPLIT, tmp_path / f"{name}-out", ALONE)
        assert done.result is not None
        assert any("not scored in any image" in warning for warning in done.result.warnings)
        figures = [one for one in done.result.figures if one.metric == "psnr" and one.level == "group"]
        assert [one.group for one in figures] == ["training", "novel"]
        found[name] = figures
    assert all(figure.value is not None and figure.value < 20 for figure in found["left"])
    assert all(figure.n_inf == figure.n for figure in found["right"])


def test_fitted_appearance_is_refused_where_the_protocol_has_no_part_for_it(
    root: Path, dataset: Dataset, tmp_path: Path
) -> None:
    write_renders(dataset, small(), tmp_path / "s", appearance=Appearance(policy="fitted"))
    done = evaluate(tmp_path / "s", root, small(), SPLIT, tmp_path / "out", ALONE)
    assert [problem.kind for problem in done.check.problems] == ["manifest"]
    assert "lets no appearance be fitted" in done.check.problems[0].message
    assert load_protocol("lane-shift").fitted_part is None


@pytest.mark.parametrize("workers", [1, 2])
def test_swapping_a_render_after_the_check_is_found(root: Path, dataset: Dataset, tmp_path: Path, workers: int) -> None:
    """Before: the result had the hash of the first render and the score of the second. After: a problem, no result."""
    protocol = small()
    plan = write_renders(dataset, protocol, tmp_path / "s", lambda view, truth: truth // 2)
    swapped = plan.views[3]
    better = tmp_path / "better.png"
    better.write_bytes(encode_png(np.full((swapped.height_px, swapped.width_px, 3), 99, np.uint8)))

    class Swapping(NullProgress):
        """Swaps the render when the check is over and scores begin."""

        def start(self, phase: str, total: int) -> None:
            if phase == "scoring":
                better.replace(tmp_path / "s" / swapped.path)

    options = EvaluationOptions(workers=workers)
    done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", options, Swapping())
    assert not better.exists()
    assert done.result is None
    assert [problem.path for problem in done.check.problems] == [swapped.path]
    assert "changed while" in done.check.problems[0].message


def test_hash_of_a_submission_is_of_its_manifest_too(root: Path, dataset: Dataset, tmp_path: Path) -> None:
    plan = write_renders(dataset, small(), tmp_path / "s")
    first = check_submission(open_untrusted(tmp_path / "s"), plan)
    manifest = json.loads((tmp_path / "s" / MANIFEST).read_text())
    (tmp_path / "s" / MANIFEST).write_text(json.dumps({**manifest, "seed": 1}))
    second = check_submission(open_untrusted(tmp_path / "s"), plan_views(mirror.open(root), small(), SPLIT))
    assert first.hash != second.hash
    assert not second.problems
