"""The one place that resolves ``--device``: which device computes, why, and what prevents a GPU."""

from __future__ import annotations

import platform
import re
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Any, Final

from mirror.errors import DatasetError, UsageError
from mirror.installation import install_command

AUTO: Final = "auto"
CPU: Final = "cpu"
OPTION: Final = "--device"

GSPLAT_RELEASES: Final = ("1.5", "1.6")
"""Releases of gsplat, major and minor number, that render and train Gaussians on a GPU here."""

_CPU_REMEDY: Final = "--device cpu"
_GIB: Final = 1 << 30


@dataclass(frozen=True)
class Device:
    """A device that computes.

    Attributes:
        name: as torch names it: ``cpu`` or ``cuda:N``.
        reason: why it was chosen, in words.
        gsplat: installed release of gsplat that rasterizes there; None on the CPU, or where nothing is rasterized.
    """

    name: str
    reason: str
    gsplat: str | None = None

    @property
    def is_cuda(self) -> bool:
        """Return whether the device is a GPU."""
        return self.name != CPU

    def __str__(self) -> str:
        return f"device: {self.name} ({self.reason})"


def require_device_name(device: str) -> None:
    """Require that the value of ``--device`` has the form of a device's name.

    Raises:
        UsageError: it has another form.
    """
    if not re.fullmatch(r"auto|cpu|cuda(:[0-9]{1,3})?", device):
        raise UsageError(
            f"no device {device!r}", place=OPTION, expected="auto, cpu, cuda, or cuda:N",
            remedy="name one of them with --device",
        )  # fmt: skip


def resolve_device(requested: str, *, splats: bool = False) -> Device:
    """Resolve a device: the requested one, or for ``auto`` the first GPU that is usable, else the CPU.

    torch is imported only if a GPU may be chosen; there it is set to convolve float32 in full precision. The checks are
    the same for ``auto``, which states the first obstacle as its reason, and for a GPU by name, where it is an error.

    Args:
        requested: ``auto``, ``cpu``, ``cuda`` or ``cuda:N``.
        splats: whether Gaussians are rasterized, for which a GPU needs gsplat.

    Raises:
        UsageError: there is no such device, or what it needs is not installed.
    """
    require_device_name(requested)
    if requested == CPU:
        return Device(CPU, f"{OPTION} {CPU}")
    try:
        return _resolve_gpu(int(requested.partition(":")[2] or 0), splats)
    except UsageError as error:
        if requested != AUTO:
            raise
        return Device(CPU, error.problem)


def choose_device(requested: str, subject: str, *, takes_device: bool, splats: bool = False) -> Device:
    """Choose the device of a plug-in, or the CPU if the plug-in supports no choice; see `resolve_device`.

    Args:
        requested: the value of ``--device``.
        subject: the plug-in, in words, such as ``method mean``.
        takes_device: whether it computes on any device; otherwise it computes on the CPU.
        splats: whether it rasterizes Gaussians.

    Raises:
        UsageError: there is no such device, what it needs is not installed, or the plug-in takes none.
    """
    require_device_name(requested)
    if takes_device:
        return resolve_device(requested, splats=splats)
    if requested in (AUTO, CPU):
        return Device(CPU, f"{OPTION} {CPU}" if requested == CPU else f"{subject} takes no device")
    raise UsageError(
        f"{subject} takes no device", place=OPTION, expected="auto or cpu", remedy=f"{_CPU_REMEDY}, or leave it out"
    )


def require_memory(device: str, needed_bytes: int, remedy: str) -> None:
    """Require that a GPU has as much free memory as a computation is estimated to need; a CPU is not checked.

    Args:
        device: as torch names it.
        needed_bytes: the estimate.
        remedy: what to lower.

    Raises:
        DatasetError: it has less.
    """
    if device == CPU:
        return
    import torch

    free, total = torch.cuda.mem_get_info(device)
    if needed_bytes > free:
        raise DatasetError(
            f"{free / _GIB:.1f} of {total / _GIB:.1f} GiB of memory are free",
            place=device, expected=f"about {needed_bytes / _GIB:.1f} GiB", remedy=remedy,
        )  # fmt: skip


def hardware_name(device: str) -> str:
    """Return the name of a processor or GPU, for documents.

    Args:
        device: as torch names it.
    """
    if device == CPU:
        return f"{platform.machine()} CPU"
    import torch

    return str(torch.cuda.get_device_name(device))


def library_versions(device: str, *, splats: bool = False) -> dict[str, str]:
    """Return the versions of the libraries that compute on a device, and the GPU's name, for documents of runs.

    Args:
        device: as torch names it.
        splats: whether Gaussians are rasterized, on a GPU by gsplat.
    """
    versions = {"torch": version("torch")} if find_spec("torch") is not None else {}
    if device != CPU:
        import torch

        if splats:
            versions["gsplat"] = version("gsplat")
        versions["gpu"] = hardware_name(device)
        versions["cuda"] = str(torch.version.cuda or torch.version.hip)
    return versions


def _resolve_gpu(index: int, splats: bool) -> Device:
    torch = _import_torch()
    if torch.version.cuda is None and torch.version.hip is None:
        raise UsageError(
            f"torch {torch.__version__} is built for the CPU", place=OPTION, expected="a build of torch for CUDA",
            remedy=f"install the build of torch for the CUDA version of your driver, or {_CPU_REMEDY}",
        )  # fmt: skip
    if not torch.cuda.is_available():
        raise UsageError(
            "torch finds no GPU", place=OPTION, expected="a GPU and its driver",
            remedy=f"install the driver of the GPU, or a build of torch for its CUDA version, or {_CPU_REMEDY}",
        )  # fmt: skip
    count = torch.cuda.device_count()
    if index >= count:
        raise UsageError(
            f"no device 'cuda:{index}'", place=OPTION, expected=", ".join(f"cuda:{one}" for one in range(count)),
            remedy=f"--device cuda:{count - 1}, or {_CPU_REMEDY}",
        )  # fmt: skip
    gsplat = _require_gsplat() if splats else None
    # By default torch convolves float32 with ten bits of mantissa on a GPU; figures, and SSIM above all, need all.
    torch.backends.cudnn.allow_tf32 = False
    name = torch.cuda.get_device_name(index)
    parts = [name, f"torch {torch.__version__}", f"gsplat {gsplat}" if gsplat else ""]
    return Device(f"cuda:{index}", ", ".join(filter(None, parts)), gsplat)


def _import_torch() -> Any:
    """Import torch.

    Raises:
        UsageError: it is not installed.
    """
    if find_spec("torch") is None:
        raise UsageError(
            "torch is not installed", place=OPTION, expected="torch for a GPU", remedy=install_command("models")
        )
    import torch

    return torch


def _require_gsplat() -> str:
    """Return the installed release of gsplat.

    Raises:
        UsageError: gsplat is not installed, is of another generation, or has no kernels and no compiler for them.
    """
    wanted = " or ".join(GSPLAT_RELEASES)
    try:
        installed = version("gsplat")
    except PackageNotFoundError:
        raise UsageError(
            "gsplat is not installed, which rasterizes on a GPU", place=OPTION, expected=f"gsplat {wanted}",
            remedy=f"{install_command('gpu')}, or {_CPU_REMEDY}",
        ) from None  # fmt: skip
    if ".".join(installed.split(".")[:2]) not in GSPLAT_RELEASES:
        raise UsageError(
            f"gsplat {installed} is installed, which is of another generation", place=OPTION,
            expected=f"gsplat {wanted}", remedy=f"pip install 'gsplat=={GSPLAT_RELEASES[0]}.*', or {_CPU_REMEDY}",
        )  # fmt: skip
    if not _has_kernels():
        raise UsageError(
            f"gsplat {installed} has no compiled kernels, and there is no CUDA compiler (nvcc)", place=OPTION,
            expected="a wheel of gsplat with kernels, or the CUDA toolkit",
            remedy=f"install either of them, or {_CPU_REMEDY}",
        )  # fmt: skip
    return installed


@cache
def _has_kernels() -> bool:
    """Return whether gsplat comes with compiled kernels, or can compile them when it is first used."""
    if find_spec("gsplat.csrc") is not None:
        return True
    from torch.utils.cpp_extension import CUDA_HOME

    return CUDA_HOME is not None
