"""Measures how fast the site that ``mirror report`` writes for a large dataset opens in Chromium, without a network.

``python -m benchmarks report_pages [--traversals N] [--keep FOLDER]`` generates a dataset of 10 scenes (one camera, 12
frames in a traversal, small images), writes its site, and opens the first page and the page of a scene in the raster of
a desktop and of a phone: milliseconds from the navigation to the end of the load event, and to the first paint with
content; the median of five. The error is the number of rows that a page has too few. Bar: a page loads in 2 s. The
folder that is kept has a screenshot of each page.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

import mirror
from benchmarks.query import SCENES, make_image, scene_centre
from benchmarks.report import Row, report
from mirror.dataset.index import build_index
from mirror.errors import UsageError
from mirror.view.report_site import write_site
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass
from tests.leaderboard.browser import Browser, find_browser

SIZE: Final = (320, 180)
SCREENS: Final = {"desktop": (1280, 900), "phone": (390, 844)}
BAR_MS: Final = 2000.0
_LIGHTS: Final = {"day": 1.0, "dusk": 0.6, "night": 0.25}
_WEATHERS: Final = ("clear", "clouds", "rain")
_OPENINGS: Final = 5
_TIMES: Final = """(() => {
    const [page] = performance.getEntriesByType("navigation");
    const paint = performance.getEntriesByName("first-contentful-paint")[0];
    return page && page.loadEventEnd && paint ? [page.loadEventEnd, paint.startTime] : null;
})()"""


def generate(root: Path, traversals: int) -> None:
    """Generate a dataset with images, and its index."""
    import cv2

    view = np.asarray(cv2.resize(make_image(0), SIZE, interpolation=cv2.INTER_AREA), np.float64)
    images = {
        light: cv2.imencode(".jpg", (view * gain).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
        for light, gain in _LIGHTS.items()
    }
    builder = Builder(root, cameras=("front_wide",), size=SIZE)
    for scene in range(SCENES):
        builder.scene(f"s{scene}", *scene_centre(scene))
    rng = np.random.default_rng(0)
    for number in range(traversals):
        light = tuple(_LIGHTS)[int(rng.integers(3))]
        one = Pass(
            f"s{number % SCENES}",
            EPOCH + number * 1000 * SECOND,
            frames=12,
            frame_ns=SECOND,
            heading_deg=float(rng.normal(30.0, 2.0)),
            offset_m=float(rng.normal(0.0, 3.0)),
            light=light,
            weather=_WEATHERS[int(rng.integers(3))],
            images={"front_wide": images[light]},
        )
        builder.drive(f"d{number}", [one], vehicle_id=f"v{number % 7}", refused=int(rng.random() < 0.3))
    build_index(root)


def page_rows(site: Path, name: str, page: Path, rows: int, screenshots: Path | None) -> Iterator[Row]:
    """Yield the rows of one page on each screen."""
    program = find_browser()
    if program is None:
        raise UsageError("no Chromium here", remedy="apt-get install chromium")
    with tempfile.TemporaryDirectory() as profile:
        browser = Browser(program, Path(profile))
        try:
            for screen, (width, height) in SCREENS.items():
                times = []
                for _ in range(_OPENINGS):
                    browser.open(site / page, width=width, height=height)
                    while (found := browser.script(_TIMES)) is None:
                        time.sleep(0.02)
                    times.append(found)
                shown = int(browser.script("document.querySelector('.about').textContent").split()[0].replace(",", ""))
                if screenshots is not None:
                    browser.screenshot(screenshots / f"{name.replace(' ', '-')}-{screen}.png", whole=False)
                loaded, painted = np.median(times, axis=0).tolist()
                size = f"{(site / page).stat().st_size / 1e6:.2f} MB, {screen}"
                yield Row(f"{name}, loaded", size, loaded, abs(rows - shown), unit="rows", bar=BAR_MS)
                yield Row(f"{name}, first paint", size, painted, bar=BAR_MS)
        finally:
            browser.close()


def main(argv: Sequence[str]) -> int:
    """Run the benchmark and print its rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--traversals", type=int, default=1000, help="traversals of the dataset")
    parser.add_argument("--keep", type=Path, help="generate dataset and site here, and use an existing dataset")
    options = parser.parse_args(argv)

    def rows(folder: Path) -> Iterator[Row]:
        root = folder / f"traversals-{options.traversals}"
        if not (root / "index" / "snapshots").is_dir():
            generate(root, options.traversals)
        start = time.perf_counter()
        dataset = mirror.open(root)
        site = write_site(dataset, folder / "site").parent
        yield Row("write the site", f"{options.traversals:,} traversals", (time.perf_counter() - start) * 1e3)
        own = len(dataset.where(scene="s0").traversals())
        yield from page_rows(site, "first page", Path("index.html"), options.traversals, options.keep)
        yield from page_rows(site, "page of a scene", Path("scenes") / "s0.html", own, options.keep)

    with tempfile.TemporaryDirectory() as temporary:
        return report("report_pages", {"pages": rows(options.keep or Path(temporary))}, errors="rows too few")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
