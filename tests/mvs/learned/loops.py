"""A reference of one PatchmatchNet stage: numpy loops in float64, from the paper's formulas and a state dict."""

from __future__ import annotations

import numpy as np


def sigmoid(x):
    return 1.0 / (1.0 + np.exp(-x))


def convolve(x, weight, bias, reach):
    """Convolve (C, H, W) by 3 x 3 taps with dilation ``reach``, zero outside."""
    _, rows, columns = x.shape
    padded = np.pad(x, ((0, 0), (reach, reach), (reach, reach)))
    out = np.tile(bias[:, None, None], (1, rows, columns))
    for i, j in np.ndindex(3, 3):
        shifted = padded[:, i * reach : i * reach + rows, j * reach : j * reach + columns]
        out += np.einsum("oc,chw->ohw", weight[:, :, i, j], shifted)
    return out


def sample_bilinear(values, x, y):
    """Sample (H, W) bilinearly at sample coordinates; coordinates outside take the value at the border."""
    rows, columns = values.shape
    x, y = min(max(x, 0.0), columns - 1.0), min(max(y, 0.0), rows - 1.0)
    left, top = int(x), int(y)
    right, bottom = min(left + 1, columns - 1), min(top + 1, rows - 1)
    a, b = x - left, y - top
    upper = (1 - a) * values[top, left] + a * values[top, right]
    return (1 - b) * upper + b * ((1 - a) * values[bottom, left] + a * values[bottom, right])


def iterate_positions(pattern, moves, v, u, rows, columns):
    """Yield the neighbour coordinates of (v, u) with the published scaling: W / (W - 1), minus half a sample."""
    for number, (down, right) in enumerate(pattern):
        x = u + right + moves[2 * number, v, u]
        y = v + down + moves[2 * number + 1, v, u]
        yield x * columns / (columns - 1) - 0.5, y * rows / (rows - 1) - 0.5


def compute_score(groups, state, prefix, last):
    """Apply three layers to the last axis of (..., G); the first two have normalisation and a rectifier."""
    x = groups
    for layer in ("conv0", "conv1"):
        weight = state[f"{prefix}.{layer}.conv.weight"][:, :, 0, 0, 0]
        norm = {
            name: state[f"{prefix}.{layer}.bn.{name}"] for name in ("weight", "bias", "running_mean", "running_var")
        }
        x = (x @ weight.T - norm["running_mean"]) / np.sqrt(norm["running_var"] + 1e-5) * norm["weight"] + norm["bias"]
        x = np.maximum(x, 0.0)
    return x @ state[f"{prefix}.{last}.weight"][0, :, 0, 0, 0] + state[f"{prefix}.{last}.bias"][0]


def compute_group_similarity(a, b, groups):
    """Compute the mean products over the channels of each group of (C,) and (C,)."""
    return (a * b).reshape(groups, -1).mean(1)


def stage_by_loops(state, level, reference, views, near_m, far_m, depth, view_weights, last):
    """Compute one iteration from a depth (H, W) and weights of the sources (V, H, W).

    Args:
        views: for each source the features (C, h, w), and the rotation and translation of its motion.

    Returns:
        Depth (H, W) and probability (D, H, W).
    """
    _, rows, columns = reference.shape
    low, extent = 1.0 / far_m, 1.0 / near_m - 1.0 / far_m
    half = level.hypotheses // 2
    inverse = np.stack([1.0 / depth + level.interval * extent * k for k in range(-half, level.hypotheses - half)])
    hypotheses = 1.0 / np.clip(inverse, low, low + extent)
    reach = level.reach
    if level.propagated:
        steps = [(i, j) for i in (-reach, 0, reach) for j in (-reach, 0, reach) if (i, j) != (0, 0)]
        pattern = (steps + [(2 * i, 2 * j) for i, j in steps])[: level.propagated]
        moves = convolve(reference, state["propa_conv.weight"], state["propa_conv.bias"], reach)
        middle = hypotheses[level.hypotheses // 2]
        propagated = np.array(
            [
                [
                    [sample_bilinear(middle, x, y) for x, y in iterate_positions(pattern, moves, v, u, rows, columns)]
                    for u in range(columns)
                ]
                for v in range(rows)
            ]
        )
        hypotheses = np.sort(np.concatenate((hypotheses, np.moveaxis(propagated, -1, 0))), axis=0)
    count = len(hypotheses)

    similarity = np.zeros((count, rows, columns, level.groups))
    for d, v, u in np.ndindex(count, rows, columns):
        total = 1e-5
        for (feature, rotation, translation), weight in zip(views, view_weights[:, v, u]):
            projected = rotation @ (u, v, 1.0) * hypotheses[d, v, u] + translation
            x, y = projected[:2] / projected[2]
            sampled = np.zeros(len(feature))
            left, top = int(np.floor(x)), int(np.floor(y))
            for j, i in ((top, left), (top, left + 1), (top + 1, left), (top + 1, left + 1)):
                if projected[2] > 0.0 and 0 <= j < feature.shape[1] and 0 <= i < feature.shape[2]:
                    sampled += feature[:, j, i] * (1.0 - abs(x - i)) * (1.0 - abs(y - j))
            similarity[d, v, u] += weight * compute_group_similarity(sampled, reference[:, v, u], level.groups)
            total += weight
        similarity[d, v, u] /= total
    scores = compute_score(similarity, state, "evaluation.similarity_net", "similarity")

    nine = [(i, j) for i in (1 - reach, 0, reach - 1) for j in (1 - reach, 0, reach - 1)]
    moves = convolve(reference, state["eval_conv.weight"], state["eval_conv.bias"], reach)
    share = (1.0 / hypotheses - low) / extent
    aggregated = np.zeros((count, rows, columns))
    for v, u in np.ndindex(rows, columns):
        at = list(iterate_positions(nine, moves, v, u, rows, columns))
        neighbours = [np.array([sample_bilinear(channel, x, y) for channel in reference]) for x, y in at]
        groups = np.stack(
            [compute_group_similarity(feature, reference[:, v, u], level.groups) for feature in neighbours]
        )
        similarity_weights = sigmoid(compute_score(groups, state, "feature_weight_net", "similarity"))
        for d in range(count):
            far = [abs(sample_bilinear(share[d], x, y) - share[d, v, u]) / level.interval for x, y in at]
            weight = sigmoid(4.0 - 2.0 * np.clip(far, 0.0, 4.0)) * similarity_weights
            aggregated[d, v, u] = weight @ [sample_bilinear(scores[d], x, y) for x, y in at] / weight.sum()
    probability = np.exp(aggregated - aggregated.max(0))
    probability /= probability.sum(0)
    if not last:
        return (probability * hypotheses).sum(0), probability
    index = (probability * np.arange(count)[:, None, None]).sum(0) / (count - 1)
    first, final = 1.0 / hypotheses[0], 1.0 / hypotheses[-1]
    return 1.0 / (first + index * (final - first)), probability
