"""A small hand-made street plan: a main street along x, a signalled cross street, and a street at the ROI's edge."""

from __future__ import annotations

import itertools

import numpy as np

from mirror.traffic.lanes.network import Lane, Network

RADIUS = 120.0
EXTENT = RADIUS + 80.0
CROSS, EDGE = 0.28 * RADIUS, -0.975 * RADIUS
HALF, LANE, FOOT = 10.0, 1.75, 6.8


def straight(start, end) -> np.ndarray:
    start, end = np.array(start, float), np.array(end, float)
    count = max(int(np.hypot(*(end - start))), 1) + 1
    return np.column_stack([start + np.linspace(0, 1, count)[:, None] * (end - start), np.zeros(count)])


def curve(start, way_in, end, way_out) -> np.ndarray:
    """A cubic curve between two points with given directions."""
    start, end = np.array(start, float), np.array(end, float)
    pull = 0.4 * np.hypot(*(end - start)) * (1.35 if abs(np.dot(way_in, way_out)) < 0.5 else 1.0)
    a, b = start + pull * np.array(way_in), end - pull * np.array(way_out)
    f = np.linspace(0, 1, 25)[:, None]
    xy = (1 - f) ** 3 * start + 3 * (1 - f) ** 2 * f * a + 3 * (1 - f) * f**2 * b + f**3 * end
    return np.column_stack([xy, np.zeros(len(xy))])


def heights(x, y):
    return 0.02 * x + 0.01 * y + 0.4 * np.sin(x / 60.0)


def motorway() -> Network:
    """Two lanes in the same direction, along x."""
    lanes = {}
    for number in range(2):
        ends = [-EXTENT, 0.0, EXTENT]
        for part, (low, high) in enumerate(itertools.pairwise(ends)):
            lanes[f"m{part}.{number}"] = Lane(
                f"m{part}.{number}", "drive", straight((low, 3.6 * number), (high, 3.6 * number)), 3.6, 30.0,
                successors=(f"m1.{number}",) if part == 0 else (),
                left=f"m{part}.1" if number == 0 else None, right=f"m{part}.0" if number == 1 else None,
            )  # fmt: skip
    return Network(lanes, np.zeros((0, 2)), 60.0)


def network() -> Network:
    lanes: dict[str, Lane] = {}

    def add(lane_id, use, line, speed=13.0, **more) -> None:
        lanes[lane_id] = Lane(lane_id, use, line, 3.3, speed, **more)

    ends: dict[str, list[tuple[str, np.ndarray, np.ndarray]]] = {}
    starts: dict[str, list[tuple[str, np.ndarray, np.ndarray]]] = {}

    def street(name, axis, offset, cuts) -> None:
        """Both directions of a street along an axis, split at the crossings (place, name, group)."""
        ahead, side = np.eye(2)[axis], np.eye(2)[1 - axis] * (-1 if axis == 0 else 1)
        for sign in (1, -1):
            marks = sorted(cuts, key=lambda cut: sign * cut[0])
            place, number, arrived = -sign * EXTENT, 0, None
            for cut, at, group in [*marks, (None, None, None)]:
                stop = sign * EXTENT if cut is None else cut - sign * HALF
                lane_id = f"{name}{'+' if sign > 0 else '-'}{number}"
                base = side * sign * LANE + np.eye(2)[1 - axis] * offset
                line = straight(base + ahead * place, base + ahead * stop)
                stop_m = None if cut is None else float(np.hypot(*(line[-1] - line[0])[:2])) - 0.5
                add(lane_id, "drive", line, stop_m=stop_m, signal=group)
                if arrived is not None:
                    starts.setdefault(arrived, []).append((lane_id, line[0, :2], ahead * sign))
                if at is not None:
                    ends.setdefault(at, []).append((lane_id, line[-1, :2], ahead * sign))
                    arrived, place, number = at, cut + sign * HALF, number + 1

    street("main", 0, 0.0, [(CROSS, "signals", 0), (EDGE, "corner", None)])
    street("cross", 1, CROSS, [(0.0, "signals", 1)])
    street("edge", 1, EDGE, [(0.0, "corner", None)])
    for crossing in ("signals", "corner"):
        turns = []
        for (a, place, way_in), (b, goal, way_out) in itertools.product(ends[crossing], starts[crossing]):
            if np.dot(way_in, way_out) < -0.5:
                continue
            turn = f"{a}>{b}"
            add(turn, "turn", curve(place, way_in, goal, way_out), 13.0 if np.dot(way_in, way_out) > 0.5 else 8.0)
            lanes[turn] = Lane(**{**vars(lanes[turn]), "successors": (b,)})
            lanes[a] = Lane(**{**vars(lanes[a]), "successors": (*lanes[a].successors, turn)})
            turns.append((turn, way_in, way_out))
        for turn, way_in, way_out in turns:
            left = way_in[0] * way_out[1] - way_in[1] * way_out[0] > 0.5
            met = [(o, i, u) for o, i, u in turns if left and np.dot(i, way_in) < -0.5]
            first = [o for o, i, u in met if i[0] * u[1] - i[1] * u[0] < 0.5]
            if crossing == "corner" and abs(way_in[1]) > 0.5:
                first += [o for o, i, _ in turns if abs(i[0]) > 0.5]
            lanes[turn] = Lane(**{**vars(lanes[turn]), "yields_to": tuple(first)})
    for side, sign in itertools.product((-1, 1), (1, -1)):
        way = f"walk{side}{sign}"
        pieces = [-EXTENT, CROSS - 8, CROSS + 8, EXTENT] if sign > 0 else [EXTENT, CROSS + 8, CROSS - 8, -EXTENT]
        for number, (low, high) in enumerate(itertools.pairwise(pieces)):
            name = f"{way}.{number}"
            y = side * (FOOT + (0.6 if sign * side > 0 else -0.2))
            group = 0 if number == 1 else None
            add(
                name, "cross" if number == 1 else "walk", straight((low, y), (high, y)), 1.4,
                successors=(f"{way}.{number + 1}",) if number < 2 else (), signal=group,
                stop_m=0.2 if number == 1 else None,
            )  # fmt: skip
    return Network(lanes, np.array([[0.0, 22.0], [28.0, 46.0]]), 52.0)
