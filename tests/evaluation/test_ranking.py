"""The ranking key of a protocol: its checks, its mean over groups, and who leads with it: report and comparison."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mirror.arrays import UInt8
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import SchemaError
from mirror.evaluation.compare import compare
from mirror.evaluation.report import write_report
from mirror.evaluation.run import EvaluationOptions, evaluate
from mirror.protocols.document import load_protocol, protocol_names
from mirror.protocols.ranking import ALL, Gate, Ranking, group_title
from mirror.protocols.views import RenderView
from tests.evaluation.submissions import SPLIT, small, small_text, write_renders

GROUPS = '[[groups]]\nname = "training"\nroles = ["train"]\n\n[[groups]]\nname = "novel"\nroles = ["held_out"]\n'
BOTH = '[ranking]\nmetric = "ssim"\ngroups = ["training", "novel"]\n'
ALONE = EvaluationOptions(workers=1)


def noisy(strength: float, seed: int):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(seed)

    def change(view: RenderView, truth: UInt8) -> UInt8:
        noise = rng.normal(0.0, strength * (2 if view.group == "novel" else 1), truth.shape)
        return np.clip(truth + noise, 0, 255).astype(np.uint8)

    return change


@pytest.mark.parametrize(
    "ranking",
    [
        '[ranking]\nmetric = "fid"\ngroups = ["novel"]\n',
        '[ranking]\nmetric = "ssim"\ngroups = ["sideways"]\n',
        '[ranking]\nmetric = "ssim"\ngroups = ["novel", "novel"]\n',
        '[ranking]\nmetric = "ssim"\ngroups = []\n',
        '[ranking]\nmetric = "ssim"\ngroups = ["novel"]\ndirection = "higher"\n',
        '[ranking]\nmetric = "ssim"\ngroups = ["novel"]\ngate = { metric = "psnr" }\n',
        '[ranking]\nmetric = "ssim"\ngroups = ["novel"]\ngate = { metric = "lpips_alex", at_most = 0.5 }\n',
    ],
)
def test_wrong_key_is_refused(ranking: str) -> None:
    with pytest.raises(SchemaError, match=r"ranking|gate"):
        small(more=ranking)


def test_every_shipped_protocol_of_scores_has_a_key_without_a_colour_fit() -> None:
    for name in protocol_names():
        ranking = load_protocol(name).ranking
        # Figures of costs are stated by participants: none of them ranks.
        assert (ranking is None) == (name == "runtime"), name
        assert ranking is None or ranking.metric not in ("psnr_cc", "psnr_affine")
    assert len(load_protocol("lane-shift").ranking.groups) == 6  # type: ignore[union-attr]


def test_hash_covers_the_key() -> None:
    with_key = small(groups=GROUPS, more=BOTH)
    assert with_key.hash != small(groups=GROUPS).hash
    assert "ranking" not in small(groups=GROUPS).model_dump(mode="json")


def test_gate_needs_its_figure() -> None:
    ranking = Ranking(metric="ssim", groups=("novel",), gate=Gate(metric="psnr", at_least=20.0, at_most=40.0))
    for value, passes in ((19.9, False), (20.0, True), (40.0, True), (40.1, False)):
        assert ranking.passes_gate({("novel", "psnr"): value}.get) is passes
    assert not ranking.passes_gate({}.get)


def test_report_comparison_and_board_lead_with_the_mean_over_groups(
    root: Path, dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    protocol_file = tmp_path / "mine.toml"
    protocol_file.write_text(small_text(groups=GROUPS, every=20, more=BOTH))
    protocol = small(groups=GROUPS, every=20, more=BOTH)
    for name, strength in (("fine", 4.0), ("coarse", 12.0)):
        write_renders(dataset, protocol, tmp_path / name, noisy(strength, 0), name=name)
    words = [str(root), str(tmp_path / "fine"), "--protocol", str(protocol_file), "--split", SPLIT, "--workers", "1"]
    assert main(["evaluate", *words, "--out", str(tmp_path / "fine-results")]) == 0
    printed = capsys.readouterr().out
    assert printed.index("ssim (ranks)") < printed.index("psnr")

    done = evaluate(tmp_path / "coarse", root, protocol, SPLIT, tmp_path / "coarse-results", ALONE)
    result = done.result
    assert result is not None
    values = {(one.group, one.metric): one.value for one in result.figures if one.level == "group"}
    for metric in ("psnr", "ssim"):
        groups = [values["training", metric], values["novel", metric]]
        assert values[ALL, metric] == pytest.approx(np.mean(groups), abs=1e-12)

    write_report(done, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert page.count('class="tile"') == 1
    assert f"<b>{values[ALL, 'ssim']:.4f}</b><span>{group_title(ALL)}: SSIM; ranks results" in page

    _, (other,) = compare([tmp_path / "fine-results", tmp_path / "coarse-results"])
    leading = other.rows[0]
    assert (leading.group, leading.metric, leading.ranks) == (ALL, "ssim", True)
    assert not any(row.ranks for row in other.rows[1:])
    of_groups = [row.difference for row in other.rows if row.metric == "ssim" and row.group != ALL]
    assert leading.difference == pytest.approx(np.mean(of_groups), abs=1e-12)
    assert main(["compare", str(tmp_path / "fine-results"), str(tmp_path / "coarse-results"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["others"][0]["rows"][0]["ranks"] is True
