"""Measures the ROI trigger, copying, memory and start-up of ingest, against simpler methods.

``python -m benchmarks ingest [trigger] [copy] [memory] [startup] [--poses N] [--rois N] [--megabytes N]``

- trigger: generated city driving at 10 Hz with some faults, against ROIs of 200 m, from longitude and latitude, with
  cleaning, on one core. Errors against Karney's geodesics: the distance of entries and exits from the circle; against
  bisection: their times, where the radial speed is at least 1 m/s; and the number of passes that differ from the plain
  reference of the tests. The peer, numpy over all poses and ROIs on a sphere, neither cleans nor interpolates.
- copy: a generated recording of seven cameras, against ``cp -r`` of the same bytes, in turns, each from a quiet disk;
  the error is the number of images that differ.
- memory: the peak memory of an ingest and its index in its own process, for drives of an hour at 10 Hz; the error is
  the increase in MB over an ingest of a tenth of the drives, at most 50. Few or all poses of a drive are in the ROI.
- startup: new processes.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.ingest.raw_recording import raw_recording
from benchmarks.ingest.traffic import Traffic, traffic
from benchmarks.report import Peer, Row, best_ms, median_ms, report
from mirror.arrays import Bool, Float64
from mirror.geometry.geodesy import ecef_to_geodetic, geodetic_to_ecef, geodetic_to_utm, utm_to_geodetic
from mirror.ingest.clean import CleanTrack, clean
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.ingest.trigger import Pass, RoiTrigger
from mirror.recordings.protocol import Track
from mirror.schema.documents import CleaningOptions, Roi, TriggerOptions
from tests.ingest import reference
from tests.ingest.long_drives import RADIUS_M, peak_bytes, write_drives
from tests.ingest.reference_cleaning import Fix
from tests.ingest.surfaces import Globe, centre_of

SECTIONS = ("trigger", "copy", "memory", "startup")
SUBSET = 200_000
BLOCK = 16_384
PAIRS = 5
UTM_ZONE = 32
MEMORY_POSES = 36_000


@contextmanager
def one_core() -> Iterator[None]:
    """Run on one core."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


# --- trigger ------------------------------------------------------------------------------------------------------


def trigger_rows(poses: int, rois: int) -> Iterator[Row]:
    """Yield the rows of the trigger against brute force, with its errors."""
    made = traffic(poses, rois)
    trigger = RoiTrigger(made.rois, TriggerOptions(), CleaningOptions())

    def run(track: Track = made.track) -> list[Pass]:
        return trigger.passes(clean(track, CleaningOptions())[0])

    with one_core():
        ms = median_ms(run, 9)
        start = time.perf_counter()
        inside = brute_force(made)
        peer_ms = (time.perf_counter() - start) * 1e3
    size = f"{poses:,} x {rois}"
    found = run()
    print(f"{inside.any(axis=0).mean():.1%} of the poses inside a ROI; {len(found)} passes")
    cleaned, _ = clean(made.track, CleaningOptions())
    off_mm, late_ms = crossing_errors(cleaned, found, made.rois)
    peers = (Peer("numpy, all pairs", peer_ms, brute_force_off_mm(made, inside)),)
    yield Row("trigger, cleaning included", size, ms, off_mm, peers, "mm off the circle", 300.0)
    yield Row("its times, at 1 m/s and more", size, ms, late_ms, unit="ms off")
    lon, lat = coordinates(made.track)
    part = Track(made.track.timestamp_ns[:SUBSET], lon[:SUBSET], lat[:SUBSET])
    start = time.perf_counter()
    expected = reference.passes(part, made.rois)
    reference_ms = (time.perf_counter() - start) * 1e3
    with one_core():
        ms = median_ms(partial(run, part), 9)
    differing = len(pass_keys(run(part)) ^ {(one.scene_id, one.entry_ns // 10**6, one.rule) for one in expected})
    peers = (Peer("plain reference", reference_ms, 0.0),)
    yield Row("its passes", f"{len(part):,} x {rois}", ms, differing, peers, f"of {len(expected)} differ")


def coordinates(track: Track) -> tuple[Float64, Float64]:
    """Return the longitude and latitude of a track."""
    if track.longitude_deg is None or track.latitude_deg is None:
        raise ValueError("the track is in a local frame")
    return track.longitude_deg, track.latitude_deg


def pass_keys(passes: Iterable[Pass]) -> set[tuple[str, int, str | None]]:
    """Return the keys of passes: scene, entry in milliseconds, and the rule that decided."""
    return {(one.scene_id, one.entry_ns // 10**6, one.rule) for one in passes}


def brute_force(made: Traffic) -> Bool:
    """Mark which poses are inside which ROIs on a sphere (R, N): numpy over all pairs, in blocks that fit the cache."""
    lon, lat = (np.radians(axis) for axis in coordinates(made.track))
    centres = np.radians([[roi.longitude_deg or 0.0, roi.latitude_deg or 0.0] for roi in made.rois])
    inside = np.empty((len(made.rois), len(lon)), bool)
    for start in range(0, len(lon), BLOCK):
        part = slice(start, start + BLOCK)
        for number, (lon0, lat0) in enumerate(centres):
            x, y = (lon[part] - lon0) * np.cos(lat0), lat[part] - lat0
            np.less_equal(x * x + y * y, (made.rois[number].radius_m / 6_371_000.0) ** 2, out=inside[number, part])
    return inside


def brute_force_off_mm(made: Traffic, inside: Bool) -> float:
    """Return the median distance of the first poses inside from their circle.

    It is the median, because some fixes are wild.
    """
    lon, lat = coordinates(made.track)
    off = []
    for roi, mask in zip(made.rois, inside):
        first = np.flatnonzero(mask[1:] & ~mask[:-1]) + 1
        centre = np.array([centre_of(roi)])
        if len(first):
            places = np.column_stack([lon[first], lat[first]])
            off.append(np.abs(Globe().distances(places, centre) - roi.radius_m))
    return float(np.median(np.concatenate(off))) * 1e3


def crossing_errors(track: CleanTrack, passes: Iterable[Pass], rois: Iterable[Roi]) -> tuple[float, float]:
    """Return the largest errors of entries and exits: from their circles, in mm, and of their times, in ms."""
    globe, kept = Globe(), track.kept()
    stamps = track.timestamp_ns[kept]
    by_id = {roi.scene_id: roi for roi in rois}
    off_m, late_ns = 0.0, 0.0
    for one in passes:
        roi = by_id[one.scene_id]
        centre = centre_of(roi)
        for t, place, kind in ((one.entry_ns, one.entry, one.entry_kind), (one.exit_ns, one.exit, one.exit_kind)):
            if kind != "crossing":
                continue
            off_m = max(off_m, abs(globe.distance(place, centre) - roi.radius_m))
            after = int(np.clip(np.searchsorted(stamps, t), 1, len(stamps) - 1))
            a, b = (
                Fix(int(stamps[i]), (float(track.lon_or_x[kept[i]]), float(track.lat_or_y[kept[i]])), None, False)
                for i in (after - 1, after)
            )
            if reference.radial_speed(globe, [a, b], t, centre) < 1.0:
                continue
            in_a, in_b = (globe.distance(fix.p, centre) <= roi.radius_m for fix in (a, b))
            shares = (0.0, 1.0) if in_a else (1.0, 0.0)
            if in_a == in_b:
                nearest = reference.closest_share(globe, a.p, b.p, centre)
                shares = (nearest, float(t - a.t > nearest * (b.t - a.t)))
            share = reference.crossing_share(globe, a.p, b.p, centre, roi.radius_m, *shares)
            late_ns = max(late_ns, abs(t - a.t - share * (b.t - a.t)))
    return off_m * 1e3, late_ns * 1e-6


def conversion_rows(poses: int) -> Iterator[Row]:
    """Yield the time of the conversion of UTM and ECEF recordings before the trigger."""
    import pyproj

    lon, lat = coordinates(traffic(poses, 1).track)
    usable = np.isfinite(lon) & np.isfinite(lat)
    lon, lat, height = lon[usable], lat[usable], np.zeros(int(usable.sum()))
    size, few = f"{poses:,}", slice(0, SUBSET)
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    ecef = geodetic_to_ecef(lon, lat, height)
    easting, northing = geodetic_to_utm(lon, lat, UTM_ZONE, True)
    back = utm_to_geodetic(easting[few], northing[few], UTM_ZONE, True)
    globe = Globe()

    def off_mm(found: Iterable[Float64]) -> float:
        places = [np.column_stack(list(axes)) for axes in (found, (lon[few], lat[few]))]
        return float(globe.distances(*places).max()) * 1e3

    def proj(rows: slice = slice(None)) -> Float64:
        return np.column_stack(to_ecef.transform(lon[rows], lat[rows], height[rows]))

    with one_core():
        error = float(np.abs(ecef[few] - proj(few)).max()) * 1e3
        ms = best_ms(lambda: geodetic_to_ecef(lon, lat, height), 2)
        yield Row("lon/lat to ECEF", size, ms, error, (Peer("PROJ", best_ms(proj, 1), 0.0),), "mm")
        error = off_mm(ecef_to_geodetic(ecef[few])[:2])
        yield Row("ECEF to lon/lat (PROJ)", size, best_ms(lambda: ecef_to_geodetic(ecef), 1), error, unit="mm")
        ms = best_ms(lambda: utm_to_geodetic(easting, northing, UTM_ZONE, True), 1)
        yield Row("UTM to lon/lat (PROJ)", size, ms, off_mm(back), unit="mm, there and back")


# --- copy ---------------------------------------------------------------------------------------------------------


def copy_rows(megabytes: int, folder: Path | None) -> Iterator[Row]:
    """Ingest by copying and by linking against ``cp -r``."""
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        root = Path(temporary)
        source, copied, out = root / "raw", root / "cp", root / "out"
        roi = raw_recording(source, megabytes)
        sources = {path.name + path.parent.name: path for path in source.glob("images/*/*.jpg")}

        def cp() -> None:
            subprocess.run(["cp", "-r", source, copied], check=True)

        def ours(write: WriteOptions) -> None:
            result = ingest_recordings([source], [roi], out, IngestOptions(write=write))
            if result.failures or result.images != len(sources):
                raise RuntimeError(f"{result.images} of {len(sources)} images; {result.failures}")

        def differing() -> int:
            there = {path.name + path.parent.name: path for path in out.glob("traversals/*/recorded/*/*.jpg")}
            return len(there.keys() ^ sources.keys()) + sum(
                there[name].read_bytes() != path.read_bytes() for name, path in sources.items() if name in there
            )

        size = f"{len(sources):,} files, {sum(path.stat().st_size for path in sources.values()) / 1e6:,.0f} MB"
        ways = {
            "ingest --copy, hashed": (WriteOptions(transfer="copy", hashing=True), 1 / 0.7),
            "ingest, linked": (WriteOptions(transfer="link", hashing=False), 1 / 20),
            "ingest, linked, hashed": (WriteOptions(transfer="link", hashing=True), None),
        }
        wrong = {}
        for name, (write, _) in ways.items():
            ours(write)
            wrong[name] = differing()
            shutil.rmtree(out)
        for name, (write, share) in ways.items():
            turns = range(PAIRS + 1)
            # The first pair is left out: it uses fresh memory, which favours the function that runs first.
            pairs = np.array([pair_ms(cp, copied, partial(ours, write), out, bool(turn % 2)) for turn in turns])[1:]
            theirs, mine = np.median(pairs, axis=0)
            # The bar is a ratio within each pair, because both runs of a pair use the same disk in the same state.
            ratio = float(np.median(pairs[:, 1] / pairs[:, 0]))
            bar = None if share is None else mine * share / ratio
            peers = (Peer("cp -r", theirs, 0.0),)
            yield Row(f"{name}: {1 / ratio:.3g} x cp", size, mine, wrong[name], peers, "files differ", bar)
            fastest = pairs[:, 0].min() / pairs[:, 1].min()
            spread = ", ".join(f"{a / b:.3g}" for a, b in pairs)
            print(f"    times as fast as cp: {spread}; fastest run against fastest run: {fastest:.3g}")


def pair_ms(
    theirs: Callable[[], None], made: Path, ours: Callable[[], None], out: Path, ours_first: bool
) -> tuple[float, float]:
    """Return the times of two functions that alternate in running first."""
    if ours_first:
        mine = quiet_ms(ours, out)
        return quiet_ms(theirs, made), mine
    return quiet_ms(theirs, made), quiet_ms(ours, out)


def quiet_ms(call: Callable[[], None], made: Path) -> float:
    """Return the time of a call on an idle disk; its output is removed."""
    os.sync()
    start = time.perf_counter()
    call()
    elapsed = (time.perf_counter() - start) * 1e3
    shutil.rmtree(made)
    return elapsed


# --- memory -------------------------------------------------------------------------------------------------------


def memory_rows(drives: int) -> Iterator[Row]:
    """Yield the peak memory of an ingest of many drives against that of a tenth of them."""
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        recordings = write_drives(root / "fleet", drives, MEMORY_POSES)
        for name, radius_m in (("a sixth", 0.5 * RADIUS_M), ("all", 2.5 * RADIUS_M)):
            few = peak_bytes(recordings[: drives // 10], root / f"few {name}", radius_m)
            start = time.perf_counter()
            many = peak_bytes(recordings, root / f"many {name}", radius_m)
            elapsed = (time.perf_counter() - start) * 1e3
            print(f"    {name} inside: {few / 1e6:.0f} MB of {drives // 10} drives, {many / 1e6:.0f} MB of {drives}")
            size = f"{drives} x {MEMORY_POSES:,} poses"
            yield Row(f"memory, {name} inside", size, elapsed, (many - few) / 1e6, unit="MB more", error_bar=50.0)


# --- start-up -----------------------------------------------------------------------------------------------------


def startup_rows() -> Iterator[Row]:
    """Yield the rows of new processes; the peer is the interpreter alone."""
    bare = median_ms(partial(process, "-c", ""), 7)
    yield Row("import mirror", "a process", median_ms(partial(process, "-c", "import mirror"), 7), None, bar=300.0)
    run = "import sys; from mirror.cli.main import main; sys.exit(main())"
    peers = (Peer("python alone", bare),)
    yield Row("mirror --help", "a process", median_ms(partial(process, "-c", run, "--help"), 7), None, peers, bar=400.0)


def process(*arguments: str) -> None:
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)


def main(argv: list[str]) -> int:
    """Run the benchmark and print its rows."""
    summary, _, details = (__doc__ or "").partition("\n\n")
    parser = argparse.ArgumentParser(
        prog="benchmarks ingest",
        description=summary,
        epilog=details,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("sections", nargs="*", choices=[[], *SECTIONS], help="default: all")
    parser.add_argument("--poses", type=int, default=10_000_000)
    parser.add_argument("--rois", type=int, default=100)
    parser.add_argument("--megabytes", type=int, default=1500, help="of generated images")
    parser.add_argument("--drives", type=int, default=100, help="whose peak memory is measured")
    parser.add_argument("--folder", type=Path, help="where the recording is generated; default: the temporary folder")
    options = parser.parse_args(argv)
    groups = {
        "trigger": lambda: trigger_rows(options.poses, options.rois),
        "conversion": lambda: conversion_rows(options.poses),
        "copy": lambda: copy_rows(options.megabytes, options.folder),
        "memory": lambda: memory_rows(options.drives),
        "startup": startup_rows,
    }
    selected = options.sections or SECTIONS
    if "trigger" in selected:
        selected = [*selected, "conversion"]
    return report("ingest", {name: rows() for name, rows in groups.items() if name in selected})


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
