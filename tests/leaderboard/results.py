"""A result as `mirror evaluate` writes it, with PSNR only."""

from __future__ import annotations

from typing import Any

from mirror.protocols.document import load_protocol

PROTOCOL = load_protocol("static-reconstruction")
PSNR = {"training": [20.0, 22.0, 24.0], "novel": [10.0, 12.0, float("inf"), None]}
SHARED = {"metric": "psnr", "unit": "dB", "better": "higher"}
HASHES = {"dataset_hash": "ab" * 32, "plan_hash": "cd" * 32}


def result() -> dict[str, Any]:
    """A result with PSNR only; in ``novel``, one image equals the truth and one has no value."""
    answered = {"protocol": PROTOCOL.name, "protocol_hash": PROTOCOL.hash, "split": "novel", **HASHES}
    return {
        "protocol": PROTOCOL.model_dump(mode="json"),
        "protocol_hash": PROTOCOL.hash,
        "dataset": {"split": "novel", **HASHES},
        "submission": {
            **answered,
            "method": {"name": "a method", "version": "3", "url": "http://not.secure"},
            "appearance": {"policy": "none"},
            "runtime": {"device": "a processor", "frames_per_second": 50.0},
        },
        "submission_hash": "ef" * 32,
        "figures": [
            # Traversals count alike: (20 + 22) / 2 and 24.
            {**SHARED, "group": "training", "value": 22.5, "n": 3, "low": 20.0, "high": 25.0},
            {**SHARED, "group": "training", "value": 24.0, "n": 1, "level": "traversal", "key": "two"},
            {**SHARED, "group": "novel", "value": 11.0, "n": 4, "n_inf": 1, "n_missing": 1, "interval_reason": "few"},
            {**SHARED, "group": "novel", "metric": "psnr_pooled", "value": 11.2, "n": 3},
        ],
        "unavailable": {"lpips_alex": "alexnet is not there; get it somewhere"},
        "weights": {},
        "versions": {"mirror": "0.1.0"},
        "warnings": ["a warning"],
    }
