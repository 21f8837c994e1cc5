"""A GPU that cannot be used, by command line: what to install or to lower is named, before layers are made."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest
import torch

from mirror import devices
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import ExitCode

GIB = 1 << 30
VERSIONS = {"gsplat": "1.5.3", "torch": "2.13.0"}


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """One GPU, as torch states it, with gsplat and its kernels."""
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda device: "A GPU")
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (GIB // 4, 8 * GIB))
    monkeypatch.setattr(devices, "version", VERSIONS.__getitem__)
    monkeypatch.setattr(devices, "_has_kernels", lambda: True)


def require_refused(dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]) -> str:
    """Run a verb, require that it ends without a layer or a model, and return its message."""
    assert main([word.format(data=dataset.root, out=tmp_path / "out") for word in words]) == ExitCode.COULD_NOT_RUN
    assert not (tmp_path / "out").exists()
    assert not list(Path(dataset.root).glob("traversals/*/layers/*/plane-sweep@*"))
    return capsys.readouterr().err


RECONSTRUCT = ["reconstruct", "{data}", "--split", "novel", "--initialise", "plane-sweep", "--out", "{out}"]
DEPTH = ["depth", "{data}", "--split", "novel", "--version", "gpu"]


@pytest.mark.skipif(torch.version.cuda is not None, reason="this build of torch is for CUDA")
@pytest.mark.parametrize("words", [RECONSTRUCT, DEPTH])
def test_a_build_of_torch_for_the_cpu(
    words: list[str], tiny_dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = require_refused(tiny_dataset, tmp_path, capsys, [*words, "--device", "cuda"])
    assert f"torch {torch.__version__} is built for the CPU" in said
    assert "install the build of torch for the CUDA version of your driver, or --device cpu" in said


@pytest.mark.usefixtures("gpu")
@pytest.mark.parametrize(
    "words", [RECONSTRUCT, DEPTH, ["generate", "train", "{data}", "--steps", "1", "--out", "{out}"]]
)
def test_a_device_that_does_not_exist(
    words: list[str], tiny_dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = require_refused(tiny_dataset, tmp_path, capsys, [*words, "--device", "cuda:3"])
    assert "no device 'cuda:3'; expected cuda:0" in said and "--device cuda:0, or --device cpu" in said


@pytest.mark.usefixtures("gpu")
def test_one_of_several_devices_does_not_exist(
    tiny_dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = require_refused(tiny_dataset, tmp_path, capsys, [*RECONSTRUCT, "--devices", "0,1"])
    assert "--devices 0,1: no device 'cuda:1'; expected cuda:0" in said
    assert "--device cuda:0, or --device cpu, in place of --devices" in said


@pytest.mark.usefixtures("gpu")
@pytest.mark.parametrize(
    ("installed", "kernels", "problem", "remedy"),
    [
        (None, True, "gsplat is not installed, which rasterizes on a GPU", "[gpu]"),
        ("1.4.0", True, "gsplat 1.4.0 is installed, which is of another generation", "gsplat==1.5.*"),
        (
            "1.5.3",
            False,
            "gsplat 1.5.3 has no compiled kernels, and there is no CUDA compiler",
            "install either of them",
        ),
    ],
)
@pytest.mark.parametrize("method", ["hybridworldsim", "vanilla_3dgs"])
def test_a_gpu_without_the_gsplat_that_it_needs(
    installed: str | None, kernels: bool, problem: str, remedy: str, method: str, tiny_dataset: Dataset, tmp_path: Path,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    def version(name: str) -> str:
        if name == "gsplat" and installed is None:
            raise PackageNotFoundError(name)
        return {**VERSIONS, "gsplat": str(installed)}[name]

    monkeypatch.setattr(devices, "version", version)
    monkeypatch.setattr(devices, "_has_kernels", lambda: kernels)
    said = require_refused(tiny_dataset, tmp_path, capsys, [*RECONSTRUCT, "--method", method, "--device", "cuda:0"])
    assert problem in said and remedy in said and "--device cpu" in said


@pytest.mark.usefixtures("gpu")
@pytest.mark.parametrize(
    ("words", "remedy"),
    [(RECONSTRUCT, "--width"), (DEPTH, "--width-px"), ([*DEPTH, "--width-px", "960"], "--width-px")],
)
def test_too_little_memory(
    words: list[str], remedy: str, tiny_dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = require_refused(tiny_dataset, tmp_path, capsys, [*words, "--device", "cuda:0"])
    assert "cuda:0: 0.2 of 8.0 GiB of memory are free; expected about" in said and remedy in said
