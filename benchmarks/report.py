"""Reports of benchmarks: rows of ``name, size, ms, error, peer``, a JSON file, and a plot of time against error.

Both files are written to ``benchmarks/out/<name>.json`` and ``.png``; the plot needs matplotlib (the ``view`` extra).
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

OUT = Path(__file__).parent / "out"
_HEADER = ("name", "size", "ms", "error", "bar", "peer")
_SMALLEST = 1e-17


@dataclass(frozen=True)
class Peer:
    """Time and error of another implementation of the same task.

    Attributes:
        name: library or method; it contains ``quoted`` if it was measured elsewhere.
        ms: its time.
        error: its error, in the row's unit; None: not measured.
    """

    name: str
    ms: float
    error: float | None = None

    def __str__(self) -> str:
        text = f"{self.name} {_number(self.ms)} ms"
        return text if self.error is None else f"{text}, {_number(self.error)}"


@dataclass(frozen=True)
class Row:
    """One line of a report.

    Attributes:
        name: what was measured.
        size: size of the input.
        ms: its time in milliseconds, or another figure with the unit in the name.
        error: error of the result; None if there is none.
        peers: other implementations of the same task.
        unit: unit of the error.
        bar: upper limit of ``ms``; None: no limit.
        error_bar: upper limit of ``error``; None: no limit.
    """

    name: str
    size: str
    ms: float
    error: float | None = None
    peers: tuple[Peer, ...] = ()
    unit: str = ""
    bar: float | None = None
    error_bar: float | None = None

    @property
    def is_missed(self) -> bool:
        """Return whether the row exceeds one of its limits."""
        slow = self.bar is not None and not self.ms < self.bar
        return slow or (self.error_bar is not None and not (self.error is not None and self.error < self.error_bar))

    def cells(self) -> tuple[str, ...]:
        """Return the line's cells as text."""
        error = "-" if self.error is None else f"{_number(self.error)} {self.unit}".rstrip()
        bars = [_number(bar) for bar in (self.bar, self.error_bar) if bar is not None]
        bar = f"< {', '.join(bars)}{' MISSED' if self.is_missed else ''}" if bars else "-"
        return self.name, self.size, _number(self.ms), error, bar, "; ".join(map(str, self.peers)) or "-"


def best_ms(call: Callable[[], object], repeats: int = 3) -> float:
    """Return the smallest time of some calls, after one that does not count."""
    return min(times_ms(call, repeats))


def median_ms(call: Callable[[], object], repeats: int = 5) -> float:
    """Return the median time of some calls, after one that does not count."""
    return float(np.median(times_ms(call, repeats)))


def times_ms(call: Callable[[], object], repeats: int) -> list[float]:
    """Return the times of some calls, after one that does not count."""
    call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append((time.perf_counter() - start) * 1e3)
    return times


def report(name: str, groups: Mapping[str, Iterable[Row]], *, errors: str = "error") -> int:
    """Print rows as they are measured, then write and plot them.

    Args:
        name: name of the benchmark and of its files.
        groups: rows by title; each group is a panel of the plot.
        errors: label of the error axis.

    Returns:
        The exit code: 1 if a row missed a limit.
    """
    print(_line(_HEADER))
    finished: dict[str, list[Row]] = {}
    for title, rows in groups.items():
        finished[title] = []
        for row in rows:
            print(_line(row.cells()), flush=True)
            finished[title].append(row)
    OUT.mkdir(exist_ok=True)
    lines = [{"group": title, **asdict(row)} for title, rows in finished.items() for row in rows]
    (OUT / f"{name}.json").write_text(json.dumps(lines, indent=1) + "\n")
    try:
        plot(finished, OUT / f"{name}.png", errors)
    except ModuleNotFoundError:
        print("no plot: pip install '.[view]'", file=sys.stderr)
    return int(any(row.is_missed for rows in finished.values() for row in rows))


def plot(groups: Mapping[str, Sequence[Row]], path: Path, errors: str = "error") -> None:
    """Plot time against error, a panel for each group; a line joins each row with its peers."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    plotted = {title: [row for row in rows if row.error is not None] for title, rows in groups.items()}
    plotted = {title: rows for title, rows in plotted.items() if rows}
    if not plotted:
        return
    figure, grid = pyplot.subplots(
        1, len(plotted), figsize=(5.5 * len(plotted), 7), layout="constrained", squeeze=False
    )
    for axes, (title, rows) in zip(grid[0], plotted.items()):
        for number, row in enumerate(rows, start=1):
            colour = f"C{(number - 1) % 10}"
            own_point = (row.ms, max(row.error or 0.0, _SMALLEST))
            for peer in row.peers:
                if peer.error is not None:
                    peer_point = (peer.ms, max(peer.error, _SMALLEST))
                    axes.plot(*zip(own_point, peer_point), color=colour, alpha=0.3, zorder=1)
                    axes.scatter(*peer_point, color=colour, marker="x", zorder=2)
            label = f"{number} {row.name}" + (f" ({row.unit})" if row.unit else "")
            axes.scatter(*own_point, color=colour, zorder=3, label=label)
            axes.annotate(str(number), own_point, xytext=(4, 3), textcoords="offset points")
        axes.set(xscale="log", yscale="log", xlabel="time (ms)", title=title)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2)
    grid[0][0].set_ylabel(errors)
    figure.suptitle("MIRROR (dots) and peers (crosses)")
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def _number(value: float) -> str:
    """A short text of a number of any magnitude."""
    if value == 0.0:
        return "0"
    if 0.01 <= abs(value) < 1e6:
        return f"{value:.0f}" if abs(value) >= 1000 or value == int(value) else f"{value:.3g}"
    return f"{value:.0e}"


def _line(cells: Sequence[str]) -> str:
    name, size, ms, error, bar, peer = cells
    return f"{name:44} {size:20} {ms:>9}  {error:24} {bar:16} {peer}"
