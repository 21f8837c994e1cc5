"""Settings on a GPU: as many more Gaussians as images have more pixels; settings by hand replace them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hybridworldsim.methods.estimates import describe_costs, estimate_task_bytes
from hybridworldsim.methods.gpu_settings import size_factor
from hybridworldsim.methods.street import METHOD, table_sizes
from hybridworldsim.model.settings import Settings
from mirror.errors import DatasetError
from mirror.methods.plugin import ReconstructionTask
from mirror.methods.registry import load_method
from mirror.progress import NullProgress
from mirror.protocols.document import load_protocol

NAMES = ("hybridworldsim", "hybridworldsim_structure", "vanilla_3dgs", "mtgs_style", "omnire_style")


def task(device: str, width_px: int, **changes: object) -> ReconstructionTask:
    protocol = load_protocol("static-reconstruction")
    scaled = protocol.model_copy(update={"pixels": protocol.pixels.model_copy(update={"max_width_px": width_px})})
    return replace(ReconstructionTask("scene", "novel", scaled, steps=30_000, device=device), **changes)  # type: ignore[arg-type]


class Lines(NullProgress):
    def __init__(self) -> None:
        self.lines: list[str] = []

    def message(self, text: str) -> None:
        self.lines.append(text)


def test_numbers_of_gaussians_follow_the_width() -> None:
    assert [size_factor(width) for width in (96, 240, 480, 960, None)] == [1.0, 1.0, 2.5, 10.0, 10.0]


@pytest.mark.parametrize("name", NAMES)
def test_every_method_has_more_gaussians_on_a_gpu(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run ends where memory is required: before any image or layer is read, and nothing is written."""
    method, lines = load_method(name), Lines()
    sizes, seen = method.sizes, []  # type: ignore[attr-defined]
    monkeypatch.setattr("torch.cuda.mem_get_info", lambda device: (1 << 28, 8 << 30))
    monkeypatch.setattr("hybridworldsim.methods.static.describe_task", lambda *_: None)
    monkeypatch.setattr("hybridworldsim.methods.static.require_own", lambda *_: None)
    monkeypatch.setattr("hybridworldsim.training.run.document.library_versions", lambda *_, **__: {})
    watched = replace(method, sizes=lambda settings: seen.append(settings) or sizes(settings))  # type: ignore[type-var]
    for given in ({}, {"seed": 3}):
        with pytest.raises(DatasetError, match=r"cuda:0: 0\.2 of 8\.0 GiB .*--width"):
            watched.reconstruct(None, task("cuda:0", 960, **given), tmp_path / "model", lines)
    plain = method.settings(0)  # type: ignore[attr-defined]
    assert sizes(seen[0]).gaussians == pytest.approx(10 * sizes(plain).gaussians, rel=1e-6)
    assert seen[1].seed == 3 and not (tmp_path / "model").exists()
    assert lines.lines[0].startswith("defaults on cuda:0: ")
    assert "refinement.most=" in lines.lines[0] or "densification.most=" in lines.lines[0]
    assert "GB of memory, 30000 steps" in lines.lines[1]


def test_settings_by_hand_replace_the_defaults_of_the_device() -> None:
    made = METHOD._settings(task("cuda:0", 960, settings={"refinement.max_anchors": "9000"}))
    assert made.refinement.max_anchors == 9000 and made.refinement.most_ground == 200_000
    assert METHOD._settings(task("cpu", 960)) == Settings()


def test_the_estimate_grows_with_gaussians_pixels_and_the_device() -> None:
    small, sizes = task("cpu", 240), table_sizes(Settings())
    assert estimate_task_bytes(sizes, task("cpu", 960)) > estimate_task_bytes(sizes, small)
    assert estimate_task_bytes(sizes, task("cuda:0", 240)) > estimate_task_bytes(sizes, small)
    assert "core-minutes" in describe_costs(sizes, small)
