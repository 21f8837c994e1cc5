"""Blocks of a scene that train on several devices at the same time, in one process for each device."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from mirror.dataset.dataset import Dataset
from mirror.dataset.dataset import open as open_dataset
from mirror.dataset.layers import LayerChoice
from mirror.executors.choice import ExecutorChoice
from mirror.executors.job import Failure, ParallelJob
from mirror.methods.plugin import InstalledMethod, ReconstructionTask
from mirror.progress import NullProgress, ProgressReporter


@dataclass(frozen=True)
class DeviceShare:
    """The blocks that one process trains.

    Attributes:
        method: the method.
        root: folder or address of the dataset.
        layers: the layers that its views read.
        task: the task, with its device and its blocks.
        out: folder of the model.
    """

    method: InstalledMethod
    root: str
    layers: LayerChoice
    task: ReconstructionTask
    out: Path


def divide_blocks(images: Mapping[str, int], devices: Sequence[str]) -> list[tuple[str, frozenset[str]]]:
    """Divide blocks among devices so that each trains about as many images; a device without a block is left out.

    Args:
        images: number of images of each block, by its name.
        devices: the devices; one may be named twice.
    """
    shares: list[list[str]] = [[] for _ in devices]
    for name in sorted(images, key=lambda one: (-images[one], one)):
        min(shares, key=lambda share: sum(images[one] for one in share)).append(name)
    return [(device, frozenset(share)) for device, share in zip(devices, shares) if share]


def train_shares(
    method: InstalledMethod,
    dataset: Dataset,
    task: ReconstructionTask,
    out: Path,
    images: Mapping[str, int],
    reporter: ProgressReporter,
) -> None:
    """Train blocks on the devices of a task, or on the workers of its executor; each ends as it does alone.

    Args:
        method: the method, which can be pickled.
        dataset: the dataset; layers that the method estimates are complete.
        task: the task, with `devices` or an `executor`, and a number of threads.
        out: folder of the model, with its document.
        images: number of images of each block to train, by its name.
        reporter: receives a message for each device, or block, that is done.

    Raises:
        DatasetError: a training failed or its process died; finished blocks and checkpoints stay.
    """
    if task.executor is None:
        shares = divide_blocks(images, task.devices)
        executor = ExecutorChoice("processes", len(shares))
    else:
        # A worker that is free takes the next block, the largest first.
        names = sorted(images, key=lambda one: (-images[one], one))
        shares, executor = [(task.device, frozenset({name})) for name in names], task.executor
    described = [f"{device}: {', '.join(sorted(blocks))}" for device, blocks in shares]
    reporter.message("; ".join(described))
    jobs = [_make_share(method, dataset, task, out, device, blocks) for device, blocks in shares]
    with executor.open() as workers:
        for number, answer in workers.map(ParallelJob(_make_training), jobs):
            if isinstance(answer, Failure):
                answer.raise_error(
                    place=str(out),
                    remedy="run the same command again: it continues. If memory ran out, train fewer blocks at a time",
                )
            reporter.message(f"{described[number] if task.executor else jobs[number].task.device}: done")


def _make_share(
    method: InstalledMethod, dataset: Dataset, task: ReconstructionTask, out: Path, device: str, blocks: frozenset[str]
) -> DeviceShare:
    own = replace(task, device=device, devices=(), executor=None, blocks=blocks)
    root = str(dataset.root)
    if "://" not in root:
        root = str(Path(root).absolute())
    return DeviceShare(method, root, dataset.layers, own, out.absolute())


def _make_training() -> Callable[[DeviceShare], None]:
    return _train


def _train(share: DeviceShare) -> None:
    dataset = open_dataset(share.root).with_layers(**asdict(share.layers))
    share.method.reconstruct(dataset, share.task, share.out, NullProgress())
