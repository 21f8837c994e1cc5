"""Seeds: public ones keep numpy's streams, secret ones give independent streams and no way back."""

from __future__ import annotations

import json
import stat
from pathlib import Path

import numpy as np
import pytest

import mirror.synth
from mirror.errors import DatasetError, SchemaError, UsageError
from mirror.synth.fleet.drives import make_drive, make_drives
from mirror.synth.fleet.presets import PRESETS
from mirror.synth.on_demand.uri import ImageName, parse_image_name
from mirror.synth.seeds import (
    PUBLIC_SEEDS,
    derive_hash_seed,
    derive_seed,
    draw_secret_seed,
    is_secret_seed,
    name_seed,
    pack_secret_seed,
    parse_public_seed,
    random_stream,
    seed_sequence,
    unpack_secret_seed,
)
from mirror.synth.writing.journal import SYNTH, open_journal
from mirror.synth.writing.secret import SECRET, read_recorded_seed, read_secret, write_secret

A = unpack_secret_seed("00" * 15 + "2a")


def test_public_seeds_have_numpys_streams() -> None:
    for seed in (0, 42, PUBLIC_SEEDS - 1):
        expected = np.random.default_rng([seed, 3, 7]).random(4)
        np.testing.assert_array_equal(random_stream("anything", seed, 3, 7).random(4), expected)
        assert derive_seed("anything", seed, 3, public=17) == derive_hash_seed("anything", seed, public=17) == 17


def test_secret_streams_differ_by_seed_purpose_and_words() -> None:
    drawn = {draw_secret_seed() for _ in range(50)}
    assert len(drawn) == 50 and all(is_secret_seed(seed) for seed in drawn)
    assert all(unpack_secret_seed(pack_secret_seed(seed)) == seed for seed in drawn)
    streams = [("traffic", A, 1), ("traffic", A, 2), ("pose errors", A, 1), ("traffic", A + 1, 1), ("traffic", A, 1, 2)]
    first = [tuple(seed_sequence(*words).generate_state(4).tolist()) for words in streams]
    assert len(set(first)) == len(streams)
    assert first[0] == tuple(seed_sequence(*streams[0]).generate_state(4).tolist())
    # Half of all bits differ between the streams of two seeds that differ in one bit.
    bits = [np.unpackbits(random_stream("x", seed).integers(0, 256, 4096, np.uint8)) for seed in (A, A ^ 1)]
    assert np.mean(bits[0] != bits[1]) == pytest.approx(0.5, abs=0.02)


def test_derived_seeds_of_a_secret_are_as_wide_as_it() -> None:
    derived = [derive_seed(purpose, A, place, public=0) for purpose in ("world", "vehicle") for place in range(500)]
    assert len(set(derived)) == 1000 and all(is_secret_seed(seed) and seed.bit_length() == 129 for seed in derived)
    # Each of the 128 bits below the mark is set in about half of them.
    shares = np.mean([[seed >> bit & 1 for bit in range(128)] for seed in derived], axis=0)
    assert np.abs(shares - 0.5).max() < 0.08
    assert 0 <= derive_hash_seed("ground", A, public=0) < 1 << 31


@pytest.mark.parametrize("preset", sorted(set(PRESETS) - {"paper"}))
def test_every_seed_of_a_secret_drive_is_wide(preset: str) -> None:
    """A seed of few bits could be found by trying all of them against the published errors of poses."""
    _, drives = make_drives(preset, A)
    for drive in drives:
        for seed in (drive.seed, drive.world_seed, drive.vehicle.seed):
            assert is_secret_seed(seed) and seed != A
        assert str(drive.seed) not in repr(drive) and str(drive.vehicle.seed) not in repr(drive)
    # Drives of one vehicle share its seed, drives of one scene that of the world.
    assert len({drive.world_seed for drive in drives}) == len({drive.scene for drive in drives})
    assert len({drive.vehicle.seed for drive in drives}) == len({drive.vehicle.vehicle_id for drive in drives})
    assert len({drive.seed for drive in drives}) == len(drives)


def test_worlds_of_two_secrets_differ() -> None:
    one, other = (make_drive("tiny", seed, "guangzhou-urban-01") for seed in (A, A + 1))
    assert one.world.model.corners.shape != other.world.model.corners.shape
    assert one.condition.start_ns != other.condition.start_ns


@pytest.mark.parametrize("text", ["-1", "x", "", str(PUBLIC_SEEDS), "9" * 5000, str(A), "٣"])
def test_doors_refuse_seeds_that_are_not_public(text: str) -> None:
    from hybridworldsim.simulator.street.of_synth import open_synthetic_street

    for open_it in (lambda: parse_public_seed(text, "--seed"), lambda: open_synthetic_street(f"synth:tiny:{text}")):
        with pytest.raises(UsageError) as caught:
            open_it()
        assert str(A) not in str(caught.value)
    name = ImageName("paper", 0, "guangzhou-urban-01", "front_wide", 7).uri()
    assert parse_image_name(name).seed == 0
    with pytest.raises((DatasetError, UsageError)):
        make_drive("paper", parse_image_name(name.replace("/0/", f"/{text}/")).seed, "guangzhou-urban-01")


def test_the_secret_stands_in_one_file_of_its_owner(tmp_path: Path) -> None:
    write_secret(tmp_path, A)
    assert read_secret(tmp_path) == A
    assert stat.S_IMODE((tmp_path / SECRET).stat().st_mode) == 0o600
    assert [path.name for path in tmp_path.iterdir()] == [SECRET]
    assert name_seed(A) == "its secret seed" and name_seed(5) == "seed 5"
    (tmp_path / SECRET).write_text(json.dumps({"format": "mirror-synth-secret", "seed": "12"}))
    with pytest.raises(SchemaError, match="seed"):
        read_secret(tmp_path)


def test_recordings_name_their_seed(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=SYNTH) as caught:
        read_recorded_seed(tmp_path, "--recordings")
    assert caught.value.place == "--recordings"
    with open_journal(tmp_path / "public", {"preset": "demo", "seed": "7"}):
        pass
    assert read_recorded_seed(tmp_path / "public", "--recordings") == ("demo", 7)
    with open_journal(tmp_path / "secret", {"preset": "demo", "seed": "secret"}):
        pass
    with pytest.raises(DatasetError, match=r"secret seed .* missing"):
        read_recorded_seed(tmp_path / "secret", "--recordings")
    write_secret(tmp_path / "secret", A)
    assert read_recorded_seed(tmp_path / "secret", "--recordings") == ("demo", A)


def test_a_secret_beside_a_public_seed_or_in_uris_is_refused(tmp_path: Path) -> None:
    for words in ({"seed": 3}, {"preset": "paper"}):
        with pytest.raises(UsageError) as caught:
            mirror.synth.write_recordings(tmp_path / "out", secret=True, **words)  # type: ignore[arg-type]
        assert caught.value.place == "--secret"
    with pytest.raises(UsageError):
        mirror.synth.write_recordings(tmp_path / "out", seed=A)
    assert not (tmp_path / "out").exists()
