"""One step of training after the other: each depends on its number, the seed and the state only."""

from __future__ import annotations

import copy
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.petr.tiny.loss import BatchBoxes, tiny_loss
from hybridworldsim.petr.tiny.network import TinyPetr, TinyRigInput
from hybridworldsim.petr.tiny.samples import Sample, rig_input
from hybridworldsim.petr.tiny.settings import NetworkSettings, TrainingSettings

_CLIP = 10.0
_GAIN, _OFFSET = 0.2, 0.1


class TinyTrainer:
    """A trainer of the network on samples that are held in memory.

    Args:
        samples: the frames.
        network: sizes of the network.
        training: how it is trained.
        seed: seed of all random numbers.
    """

    def __init__(
        self, samples: Sequence[Sample], network: NetworkSettings, training: TrainingSettings, seed: int
    ) -> None:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = TinyPetr(network)
        self.averaged = copy.deepcopy(self.network).requires_grad_(False)
        self._samples, self._settings, self._seed = samples, training, seed
        decayed = [one for one in self.network.parameters() if one.ndim > 1]
        plain = [one for one in self.network.parameters() if one.ndim <= 1]
        self._optimizer = torch.optim.AdamW(
            [{"params": decayed, "weight_decay": training.weight_decay}, {"params": plain, "weight_decay": 0.0}],
            lr=training.learning_rate,
            foreach=True,
        )
        self._epoch, self._batches = -1, list[list[int]]()
        self._per_epoch = len(self._epoch_batches(0))

    def step(self, number: int, progress: float) -> dict[str, float]:
        """Do step `number`; `progress` runs from 0 to 1. Returns the losses by name."""
        epoch, place = divmod(number, self._per_epoch)
        if epoch != self._epoch:
            self._epoch, self._batches = epoch, self._epoch_batches(epoch)
        rng = np.random.default_rng([self._seed, 1, number])
        rig, truth = self._batch([self._samples[one] for one in self._batches[place]], rng)
        rate = self._settings.learning_rate * min((number + 1) / max(self._settings.warmup, 1), 1.0)
        rate *= 0.5 * (1.0 + math.cos(math.pi * progress))
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        self.network.train()
        output, dense = self.network(rig)
        losses = tiny_loss(output, dense, truth)
        decoder = losses["class"] + losses["box"]
        total = decoder + self._settings.dense_weight * sum(
            (loss for name, loss in losses.items() if name not in ("class", "box")), torch.zeros(())
        )
        self._optimizer.zero_grad(set_to_none=True)
        total.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), _CLIP)
        self._optimizer.step()
        self._average(number)
        return {"loss": total.item(), **{name: loss.item() for name, loss in losses.items()}}

    @torch.no_grad()
    def _average(self, number: int) -> None:
        decay = min(self._settings.ema, (1 + number) / (10 + number))
        pairs = list(zip(self.averaged.state_dict().values(), self.network.state_dict().values()))
        means, values = zip(*((mean, value) for mean, value in pairs if mean.is_floating_point()))
        torch._foreach_lerp_(means, values, 1.0 - decay)

    def _epoch_batches(self, epoch: int) -> list[list[int]]:
        """Batches of frames with equally many cameras, in a random order; the last ones of an epoch may be smaller."""
        rng = np.random.default_rng([self._seed, 0, epoch])
        waiting: dict[int, list[int]] = defaultdict(list)
        batches = []
        for one in rng.permutation(len(self._samples)).tolist():
            group = waiting[len(self._samples[one].cameras.images)]
            group.append(one)
            if len(group) == self._settings.batch:
                batches.append(group.copy())
                group.clear()
        return batches + [group for group in waiting.values() if group]

    def _batch(self, samples: Sequence[Sample], rng: np.random.Generator) -> tuple[TinyRigInput, BatchBoxes]:
        rig = rig_input([one.cameras for one in samples])
        turn = np.radians(rng.uniform(-self._settings.turn_deg, self._settings.turn_deg, len(samples)))
        shape = (len(samples), rig.images.shape[1], 3, 1, 1)
        gain = torch.from_numpy(np.exp(rng.uniform(-_GAIN, _GAIN, shape)).astype(np.float32))
        offset = torch.from_numpy(rng.uniform(-_OFFSET, _OFFSET, shape).astype(np.float32))
        matrix = torch.from_numpy(_turns(turn))
        rig = replace(
            rig,
            images=rig.images * gain + offset,
            directions=torch.einsum("bij,bnhwj->bnhwi", matrix, rig.directions),
            origins=torch.einsum("bij,bnj->bni", matrix, rig.origins),
        )
        return rig, batch_boxes(samples, turn)

    def state(self) -> dict[str, Tensor]:
        """Return everything that a run needs to continue, by name."""
        state = {f"network.{name}": value for name, value in self.network.state_dict().items()}
        state |= {f"averaged.{name}": value for name, value in self.averaged.state_dict().items()}
        for number, moments in self._optimizer.state_dict()["state"].items():
            state |= {f"optimizer.{number}.{name}": torch.as_tensor(value) for name, value in moments.items()}
        return state

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Continue from the result of `state`."""
        self.network.load_state_dict(dict(_part(state, "network.")))
        self.averaged.load_state_dict(dict(_part(state, "averaged.")))
        document = self._optimizer.state_dict()
        moments: dict[int, dict[str, Tensor]] = defaultdict(dict)
        for name, value in _part(state, "optimizer."):
            number, _, key = name.partition(".")
            moments[int(number)][key] = value
        document["state"] = dict(moments)
        self._optimizer.load_state_dict(document)


def _part(state: Mapping[str, Tensor], prefix: str) -> Iterator[tuple[str, Tensor]]:
    return ((name.removeprefix(prefix), value) for name, value in state.items() if name.startswith(prefix))


def _turns(angle: np.ndarray) -> np.ndarray:
    """Matrices (B, 3, 3) that turn about z."""
    matrix = np.zeros((len(angle), 3, 3), np.float32)
    matrix[:, 0, 0] = matrix[:, 1, 1] = np.cos(angle)
    matrix[:, 1, 0], matrix[:, 0, 1], matrix[:, 2, 2] = np.sin(angle), -np.sin(angle), 1.0
    return matrix


def batch_boxes(samples: Sequence[Sample], turn: np.ndarray) -> BatchBoxes:
    """Return the boxes of samples, each turned about z by an angle."""
    boxes = [one.boxes for one in samples]
    matrix = _turns(turn)
    frame = np.repeat(np.arange(len(boxes)), [len(one.label) for one in boxes])
    centre = np.concatenate([one.centre_m @ matrix[place].T for place, one in enumerate(boxes)])
    yaw = np.concatenate([one.yaw_rad + np.float32(turn[place]) for place, one in enumerate(boxes)])

    def joined(name: str) -> Tensor:
        return torch.from_numpy(np.concatenate([getattr(one, name) for one in boxes]))

    return BatchBoxes(
        torch.from_numpy(frame), joined("label"), torch.from_numpy(centre), joined("size_m"),
        torch.from_numpy(yaw.astype(np.float32)), joined("cell"), joined("spread"),
    )  # fmt: skip
