"""Measures time and error of rasterizing Gaussians on the CPU, for images and their gradients.

``python -m benchmarks rasterizer [--quick] [--only GROUP ...] [--repeats N]``. Scenes are seeded and hashed
(`benchmarks/rasterizer/scenes.py`): random and needle-shaped Gaussians in the view, a street block of 100 m, and the
captured garden that gsplat is tested with. Every image has colours and depth. Times are warm medians with gradients to
all inputs. Errors are differences to the float64 reference, which takes minutes for an image and is cached in
``benchmarks/out``. Peers: gsplat's torch projection (gsplat cannot blend without CUDA) where gsplat is installed, and
OpenSplat's CPU path where ``MIRROR_OPENSPLAT`` names it (`benchmarks/rasterizer/opensplat.py`). Where other work runs
at the same time, set ``OMP_WAIT_POLICY=passive``: otherwise torch's waiting threads occupy the rasterizer's cores.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.rasterizer import opensplat, scenes
from benchmarks.rasterizer.errors import compute_gradient_errors, compute_image_errors, truth
from benchmarks.rasterizer.processes import measure_peak_bytes, measure_starts
from benchmarks.rasterizer.projection import projection_rows
from benchmarks.rasterizer.rolling import rolling_rows
from benchmarks.rasterizer.rolling_recorded import recorded_rows
from benchmarks.rasterizer.rolling_street import street_rows
from benchmarks.rasterizer.scenes import Splats
from benchmarks.rasterizer.views import View, both_ms, count_name, forward_ms, with_threads
from benchmarks.report import Peer, Row, report

SCENES: Final = {"random": scenes.random, "needles": scenes.needles, "street": scenes.street}
EXTREMES: Final = {"hairs": scenes.hairs}
FORWARD_BARS: Final = {
    ("random", 100_000): 50.0,
    ("random", 300_000): 55.0,
    ("random", 1_000_000): 100.0,
    ("street", 100_000): 55.0,
    ("street", 300_000): 95.0,
    ("street", 1_000_000): 215.0,
}
BACKWARD_BAR: Final = 1.7
ERROR_BAR: Final = 2e-5
_ERROR_BARS: Final = {"hairs": 3e-4}  # a millionth, divided by their width of 0.004 pixels
MARKED_PERCENT: Final = 3.0
COMPILE_S, CACHED_S = 30.0, 1.0
OPENSPLAT_FORWARD, OPENSPLAT_BACKWARD = 10.0, 5.0
_REAL_DATA: Final = Path(__file__).parents[3] / "shared" / "data"


def main(argv: list[str]) -> int:
    """Run the selected groups."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks rasterizer", description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="100 k and 300 k Gaussians, small images for errors")
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=list(GROUPS), help="what to measure")
    parser.add_argument("--repeats", type=int, default=7, help="timed calls of which the median counts")
    parser.add_argument("--threads", type=int, default=2, help="of all rows but those that name another number")
    chosen = parser.parse_args(argv)
    if os.getloadavg()[0] > 0.3:
        print(f"other work runs here (load {os.getloadavg()[0]:.1f}): times are too long", file=sys.stderr)
    with with_threads(chosen.threads):
        groups = {name: GROUPS[name](chosen.quick, chosen.repeats) for name in chosen.only}
        return report("rasterizer", groups, errors="error (as the rows say)")


def forward_rows(quick: bool, repeats: int) -> Iterator[Row]:
    """Yield the times of an image without gradients."""
    for name, count, width, height in timed_views(quick):
        view = View(_scene(name, count), width, height)
        bar = FORWARD_BARS.get((name, count)) if width == 960 else None
        yield Row(f"{name}, forward", view.size, forward_ms(view, repeats), bar=bar)


def backward_rows(quick: bool, repeats: int) -> Iterator[Row]:
    """Yield times of gradients of colours, depth and alpha to all inputs; the bar is a multiple of the forward time."""
    for name, count, width, height in timed_views(quick):
        if count > 1_000_000:
            continue
        view = View(_scene(name, count), width, height)
        alone = forward_ms(view, repeats)
        forward, backward = both_ms(view, repeats)
        yield Row(f"{name}, forward for gradients", view.size, forward)
        yield Row(f"{name}, backward", view.size, backward, bar=BACKWARD_BAR * alone)


def option_rows(quick: bool, repeats: int) -> Iterator[Row]:
    """Yield the times with other numbers of threads and channels, with spherical harmonics and with antialiasing."""
    count = 100_000 if quick else 300_000
    for name in ("random", "street"):
        plain = View(_scene(name, count), 960, 540)
        views = {
            "plain": plain,
            "7 channels": replace(plain, channels=7),
            "SH 3": replace(plain, spherical_harmonics=True),
            "antialiased": replace(plain, options={"rasterize_mode": "antialiased"}),
            "absgrad": replace(plain, options={"absgrad": True}),
        }
        for threads, shown in ((1, ["plain"]), (2, list(views))):
            for how in shown:
                with with_threads(threads):
                    forward, (_, backward) = forward_ms(views[how], repeats), both_ms(views[how], repeats)
                kind = f"{name}, {how}, {threads} thread{'s' * (threads > 1)}"
                yield Row(f"{kind}, forward", plain.size, forward)
                yield Row(f"{kind}, backward", plain.size, backward)


def error_rows(quick: bool, repeats: int) -> Iterator[Row]:
    """Yield the errors of colours and alpha against the reference.

    They are of all pixels, and of pixels that rounding cannot decide.
    """
    for view in _error_views(quick):
        errors, ms = compute_image_errors(view, truth(view, gradients=_gradient_views(view))), forward_ms(view, repeats)
        name, size = view.name, view.size
        bar = _ERROR_BARS.get(view.scene.name, ERROR_BAR)
        yield Row(f"{name}, unmarked, max", size, ms, errors.unmarked, error_bar=bar)
        yield Row(f"{name}, all pixels, 99.9 %", size, ms, errors.all_999, error_bar=bar)
        yield Row(f"{name}, all pixels, max (error)", size, errors.worst)
        yield Row(f"{name}, marked, max beyond a flip (error)", size, errors.beyond_flips, bar=2e-5)
        yield Row(f"{name}, marked (% of pixels)", size, errors.marked_percent, bar=MARKED_PERCENT)
        yield Row(f"{name}, depth, 99.9 % (relative error)", size, errors.depth)


def gradient_rows(quick: bool, repeats: int) -> Iterator[Row]:
    """Yield the errors of gradients, of a loss without marked pixels: of whole tensors and of single Gaussians."""
    for view in filter(_gradient_views, _error_views(quick)):
        bar = _ERROR_BARS.get(view.scene.name, ERROR_BAR)
        found = compute_gradient_errors(view, truth(view, gradients=True))
        worst = max(errors.norm for errors in found.values())
        yield Row(f"{view.name}, worst input, norm", view.size, both_ms(view, repeats)[1], worst, error_bar=bar)
        for name, errors in found.items():
            single = f"Gaussians: median {errors.median:.0e}, 99 % {errors.percentile_99:.0e}"
            yield Row(f"{view.name}, {name}, norm (error; {single})", view.size, errors.norm, bar=bar)


def projection_group(quick: bool, repeats: int) -> Iterator[Row]:
    """Yield the times of projection alone, with gsplat's torch projection as peer."""
    for name in ("random", "street"):
        yield from projection_rows(View(_scene(name, 100_000 if quick else 300_000), 960, 540), repeats)


def rolling_group(quick: bool, repeats: int) -> Iterator[Row]:
    """Yield the times with a rolling shutter, in pairs with the paths without one."""
    for name in ("random", "street"):
        yield from rolling_rows(View(_scene(name, 100_000 if quick else 300_000), 960, 540), repeats)


def garden_rows(quick: bool, repeats: int) -> Iterator[Row]:
    """Yield the times of one thread on the captured cloud, with OpenSplat as peer."""
    find_program = opensplat.find_program()
    garden = _garden()
    if garden is None:
        return
    for width, height in ((648, 420),) if quick else ((648, 420), (960, 622)):
        view = View(garden, width, height)
        true = truth(view, gradients=False)
        with with_threads(1):
            forward, (_, backward) = forward_ms(view, repeats), both_ms(view, repeats)
        if find_program is None:
            yield Row("garden, forward, 1 thread", view.size, forward, compute_image_errors(view, true).all_999)
            yield Row("garden, backward, 1 thread", view.size, backward)
            continue
        theirs = opensplat.run(find_program, garden, view.weights[0][0, ..., :3].contiguous().numpy())
        off = np.abs(theirs.image - true.image.numpy()).max(axis=-1)
        yield Row(
            "garden, forward, 1 thread",
            view.size,
            forward,
            compute_image_errors(view, true).all_999,
            (Peer("OpenSplat, without depth", theirs.forward_ms, float(np.quantile(off, 0.999))),),
            bar=theirs.forward_ms / OPENSPLAT_FORWARD,
        )
        yield Row(
            "garden, backward, 1 thread",
            view.size,
            backward,
            None,
            (Peer("OpenSplat, without depth", theirs.backward_ms),),
            bar=theirs.backward_ms / OPENSPLAT_BACKWARD,
        )


def process_rows(quick: bool, repeats: int) -> Iterator[Row]:
    """Yield the time of the first images of a process, and memory beyond inputs and code."""
    del repeats
    first = measure_starts()
    yield Row("first image and gradients, compiling (s)", "100 64x48", first.compiled, bar=COMPILE_S)
    yield Row("first image and gradients, cached (s)", "100 64x48", first.cached, bar=CACHED_S)
    few, many = 100_000, 300_000 if quick else 1_000_000
    for name in ("random", "street"):
        for backward in (False, True):
            small, large = (
                measure_peak_bytes(_scene(name, count), 960, 540, backward=backward) for count in (few, many)
            )
            wide = measure_peak_bytes(_scene(name, few), 1920, 1080, backward=backward)
            kind = f"{name}, {'with' if backward else 'without'} gradients"
            sizes = f"{count_name(few)} to {count_name(many)}"
            yield Row(f"{kind}, peak (B a Gaussian)", sizes, (large - small) / (many - few))
            yield Row(f"{kind}, peak (B a pixel)", "960x540 to 1920x1080", (wide - small) / (3 * 960 * 540))


def timed_views(quick: bool) -> Iterator[tuple[str, int, int, int]]:
    """Yield the views for timing: scene, number of Gaussians, size of the image."""
    for name in SCENES:
        if quick:
            counts = [100_000] if name == "needles" else [100_000, 300_000]
        else:
            counts = [10_000, 100_000, 300_000, *([] if name == "needles" else [1_000_000, 3_000_000])]
        for count in counts:
            yield name, count, 960, 540
            if count == 300_000 and not quick:
                yield name, count, 480, 270
                yield name, count, 1920, 1080


def _error_views(quick: bool) -> Iterator[View]:
    """Views that the reference renders in a minute each."""
    yield View(_scene("random", 10_000), 240, 135)
    yield View(_scene("needles", 3_000), 240, 135)
    yield View(_scene("street", 30_000), 240, 135)
    yield View(_scene("hairs", 3_000), 240, 135, options={"eps2d": 0.0})
    if not quick:
        yield View(_scene("random", 30_000), 480, 270)
        yield View(_scene("needles", 10_000), 480, 270)
        yield View(_scene("street", 100_000), 480, 270)
        for name in ("random", "street"):
            yield View(
                _scene(name, 30_000), 240, 135, spherical_harmonics=True, options={"rasterize_mode": "antialiased"}
            )
        if (garden := _garden()) is not None:
            yield View(garden, 648, 420)
        yield View(_scene("needles", 100_000), 960, 540)
        yield View(_scene("street", 300_000), 960, 540)
        yield View(_scene("random", 1_000_000), 960, 540)


def _gradient_views(view: View) -> bool:
    """Views for which the reference computes gradients in acceptable time."""
    return view.width <= 480


@lru_cache(maxsize=2)
def _scene(name: str, count: int) -> Splats:
    return (SCENES | EXTREMES)[name](count)


def _garden() -> Splats | None:
    folder = Path(os.environ.get("MIRROR_REAL_DATA", _REAL_DATA)) / "gsplat_garden"
    if folder.is_dir():
        return scenes.garden(folder)
    print(f"no garden at {folder}: set MIRROR_REAL_DATA", file=sys.stderr)
    return None


GROUPS: Final[dict[str, Callable[[bool, int], Iterator[Row]]]] = {
    "forward": forward_rows,
    "backward": backward_rows,
    "options": option_rows,
    "errors": error_rows,
    "gradients": gradient_rows,
    "projection": projection_group,
    "rolling": rolling_group,
    "rolling-street": street_rows,
    "rolling-recorded": recorded_rows,
    "garden": garden_rows,
    "process": process_rows,
}
