"""The training loss: Hungarian matching of queries with true boxes, focal loss of classes, L1 of codes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from hybridworldsim.petr.head import HeadOutput

_GAMMA, _ALPHA = 2.0, 0.25
_COST_CLASS, _COST_BOX = 2.0, 0.25
_WEIGHT_CLASS, _WEIGHT_BOX = 2.0, 0.25
_MATCHED_VALUES = 8


@dataclass(frozen=True, eq=False)
class TrueBoxes:
    """The T true boxes of one image set.

    Attributes:
        label: (T,) number of the class.
        code: (T, 10) codes with NaN for an unknown velocity.
    """

    label: Tensor
    code: Tensor


def sigmoid_focal_loss(logits: Tensor, target: Tensor) -> Tensor:
    """Return the focal loss (T.-Y. Lin et al., ICCV 2017) of each logit; ``target`` is 0 or 1."""
    p = logits.sigmoid()
    cross_entropy = F.binary_cross_entropy_with_logits(logits, target, reduction="none")
    p_true = p * target + (1.0 - p) * (1.0 - target)
    alpha = _ALPHA * target + (1.0 - _ALPHA) * (1.0 - target)
    return alpha * (1.0 - p_true) ** _GAMMA * cross_entropy


def match(logits: Tensor, code: Tensor, truth: TrueBoxes) -> tuple[Tensor, Tensor]:
    """Assign queries to true boxes so that the total cost is least.

    Args:
        logits: (Q, classes).
        code: (Q, 10).
        truth: T true boxes.

    Returns:
        Rows (K,) of queries and rows (K,) of true boxes; K = min(Q, T).
    """
    from scipy.optimize import linear_sum_assignment

    with torch.no_grad():
        p, eps = logits.sigmoid(), 1e-12
        negative = -(1.0 - p + eps).log() * (1.0 - _ALPHA) * p**_GAMMA
        positive = -(p + eps).log() * _ALPHA * (1.0 - p) ** _GAMMA
        cost = _COST_CLASS * (positive - negative)[:, truth.label]
        # The velocity is left out of the cost.
        cost = cost + _COST_BOX * torch.cdist(code[:, :_MATCHED_VALUES], truth.code[:, :_MATCHED_VALUES], p=1)
        rows, columns = linear_sum_assignment(torch.nan_to_num(cost, nan=100.0, posinf=100.0).cpu().numpy())
    return torch.as_tensor(rows), torch.as_tensor(columns)


def detection_loss(output: HeadOutput, truth: Sequence[TrueBoxes], code_weights: Tensor) -> dict[str, Tensor]:
    """Return the sum of the losses of all decoder layers.

    Args:
        output: of the head.
        truth: true boxes of each of the B image sets.
        code_weights: (10,).

    Returns:
        ``class`` and ``box``, weighted.
    """
    classes, boxes = [], []
    for logits, codes in zip(output.logits, output.codes):
        target = torch.zeros_like(logits)
        distance = logits.new_zeros(())
        positives = 0
        for place, true in enumerate(truth):
            if not len(true.label):
                continue
            rows, columns = match(logits[place], codes[place], true)
            target[place, rows, true.label[columns]] = 1.0
            difference = (codes[place][rows] - true.code[columns]).abs() * code_weights
            distance = distance + torch.where(true.code[columns].isnan(), 0.0, difference).nan_to_num().sum()
            positives += len(rows)
        share = 1.0 / max(positives, 1)
        classes.append(_WEIGHT_CLASS * share * sigmoid_focal_loss(logits, target).sum())
        boxes.append(_WEIGHT_BOX * share * distance)
    return {"class": torch.stack(classes).sum(), "box": torch.stack(boxes).sum()}
