"""One function resolves `--device`: what it chooses, why, and what it names where a GPU cannot be used."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import PackageNotFoundError

import pytest
import torch

from hybridworldsim.rasterizer.presets import PRESETS
from mirror import devices
from mirror.devices import GSPLAT_RELEASES, Device, library_versions, require_memory, resolve_device
from mirror.errors import DatasetError, UsageError

GIB = 1 << 30
no_gpu = pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")


@pytest.fixture
def gpus(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two GPUs, as torch states them, and gsplat with kernels."""
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda device: f"GPU {device}")
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (2 * GIB, 8 * GIB))
    monkeypatch.setattr(devices, "version", {"gsplat": "1.5.3", "torch": "2.13.0"}.__getitem__)
    monkeypatch.setattr(devices, "_has_kernels", lambda: True)


def test_the_cpu_is_chosen_without_torch() -> None:
    code = "import sys; from mirror.devices import resolve_device; print(resolve_device('cpu'), 'torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "device: cpu (--device cpu) False\n"


@no_gpu
def test_without_a_gpu_auto_states_the_obstacle_that_a_gpu_by_name_is_refused_for() -> None:
    chosen = resolve_device("auto", splats=True)
    assert chosen.name == "cpu" and not chosen.is_cuda
    with pytest.raises(UsageError) as caught:
        resolve_device("cuda", splats=True)
    assert caught.value.problem == chosen.reason and str(chosen) == f"device: cpu ({chosen.reason})"
    assert caught.value.place == "--device" and "--device cpu" in str(caught.value.remedy)
    if torch.version.cuda is None:
        assert chosen.reason == f"torch {torch.__version__} is built for the CPU"


@pytest.mark.parametrize("name", ["banana", "cuda:", "cuda:-1", "cuda:1000", "CPU", "mps", "cpu:0", ""])
def test_other_words_are_refused(name: str) -> None:
    with pytest.raises(UsageError, match="expected auto, cpu, cuda, or cuda:N"):
        resolve_device(name)


@pytest.mark.usefixtures("gpus")
def test_a_gpu_is_chosen_and_described() -> None:
    assert resolve_device("auto") == Device("cuda:0", f"GPU 0, torch {torch.__version__}")
    assert resolve_device("cuda:1", splats=True) == Device(
        "cuda:1", f"GPU 1, torch {torch.__version__}, gsplat 1.5.3", "1.5.3"
    )
    assert resolve_device("cpu").name == "cpu"
    assert not torch.backends.cudnn.allow_tf32 and not torch.backends.cuda.matmul.allow_tf32
    assert library_versions("cuda:1", splats=True) == {
        "torch": "2.13.0", "gsplat": "1.5.3", "gpu": "GPU cuda:1", "cuda": "13.0"
    }  # fmt: skip
    assert library_versions("cpu", splats=True) == {"torch": "2.13.0"}


@pytest.mark.usefixtures("gpus")
def test_a_gpu_that_does_not_exist_is_refused_with_those_that_do() -> None:
    with pytest.raises(UsageError, match=r"'cuda:2'.*--device cuda:1"):
        resolve_device("cuda:2")


@pytest.mark.usefixtures("gpus")
@pytest.mark.parametrize(
    ("installed", "words", "remedy"),
    [
        (None, "gsplat is not installed", r"pip install .*\[gpu\]"),
        ("1.4.0", "gsplat 1.4.0 is installed.*another generation; expected gsplat 1.5 or 1.6", "gsplat==1.5"),
        ("2.0.1", "gsplat 2.0.1 is installed.*another generation", "gsplat==1.5"),
        ("1.5.3+pt24cu124", "gsplat 1.5.3.* has no compiled kernels", "either of them"),
        ("1.6.0", "gsplat 1.6.0 has no compiled kernels", "--device cpu"),
    ],
)
def test_splats_need_a_gsplat_of_a_known_generation_with_kernels(
    monkeypatch: pytest.MonkeyPatch, installed: str | None, words: str, remedy: str
) -> None:
    def version(name: str) -> str:
        if installed is None:
            raise PackageNotFoundError(name)
        return installed

    monkeypatch.setattr(devices, "version", version)
    monkeypatch.setattr(devices, "_has_kernels", lambda: False)
    with pytest.raises(UsageError, match=f"--device: {words}.*Remedy: .*{remedy}") as caught:
        resolve_device("cuda:0", splats=True)
    assert resolve_device("auto", splats=True) == Device("cpu", caught.value.problem)
    assert resolve_device("cuda:0").is_cuda, "a network alone needs no gsplat"


def test_a_gpu_needs_torch_with_a_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(UsageError, match=r"finds no GPU.*the driver"):
        resolve_device("cuda")
    monkeypatch.setattr(devices, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"torch is not installed.*\[models\]"):
        resolve_device("cuda")
    assert resolve_device("auto") == Device("cpu", "torch is not installed")
    assert library_versions("cpu") == {}


@pytest.mark.usefixtures("gpus")
def test_too_little_memory_is_named_with_what_to_lower() -> None:
    gpu = resolve_device("cuda:1").name
    require_memory(gpu, GIB, "a smaller --width")
    require_memory("cpu", 1 << 60, "a smaller --width")
    with pytest.raises(DatasetError, match=r"cuda:1: 2\.0 of 8\.0 GiB .*--width"):
        require_memory(gpu, 6 * GIB, "a smaller --width")


def test_the_releases_of_gsplat_are_those_of_presets() -> None:
    followed = {release for preset in PRESETS.values() for release in preset.releases}
    assert set(GSPLAT_RELEASES) <= followed, "what renders on a GPU is what a preset describes"
