"""Ingest streams: memory does not grow with the number of drives."""

from __future__ import annotations

from pathlib import Path

from tests.ingest.long_drives import RADIUS_M, peak_bytes, write_drives

FEW, MANY, POSES = 4, 20, 36_000


def test_peak_memory_does_not_grow_with_the_number_of_drives(tmp_path: Path) -> None:
    """All poses of each drive lie in one traversal, so that the index has them all too."""
    drives = write_drives(tmp_path / "fleet", MANY, POSES)
    few = peak_bytes(drives[:FEW], tmp_path / "few", 2.5 * RADIUS_M)
    many = peak_bytes(drives, tmp_path / "many", 2.5 * RADIUS_M)
    # 64 bytes a pose were kept before, and more than that while the index was made.
    assert many - few < 0.5 * 64 * POSES * (MANY - FEW)
