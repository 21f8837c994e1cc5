"""Submissions for tests: small protocols, and renders made from the truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.evaluation.submission.manifest import Appearance, Runtime, SubmittedMethod
from mirror.evaluation.submission.template import make_manifest, write_manifest
from mirror.protocols.document import Protocol, parse_protocol
from mirror.protocols.png import encode_png
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import Plan, RenderView, plan_views

SPLIT = "novel"

_TEXT = """
name = "small"
version = 1
task = "{task}"
description = "for tests"
averaging = ["traversal", "scene"]
{groups}
[frames]
every = {every}
last = false
cameras = ["front_wide", "front_left"]
[pixels]
space = "{space}"
max_width_px = {width}
{more}[masks]
ego = true
dynamic = ["boxes"]
{metrics}
[intervals]
resamples = 200
block_frames = {block}
"""
LEFT_HALF = "[fitted_part]\nleft = 0.0\ntop = 0.0\nright = 0.5\nbottom = 1.0\n"
_PSNR = '[[metrics]]\nmetric = "psnr"\n'
_SSIM = '[[metrics]]\nmetric = "ssim"\npreset = "gaussian11"\nmask = "map"\n'


def small_text(
    *,
    task: str = "reconstruction",
    groups: str = '[[groups]]\nname = "novel"\nroles = ["held_out"]\n',
    every: int = 5,
    space: str = "undistorted",
    width: int = 120,
    metrics: str = _PSNR + _SSIM,
    block: int = 1,
    more: str = "",
) -> str:
    """Return a protocol with few images, as TOML."""
    return _TEXT.format(
        task=task, groups=groups, every=every, space=space, width=width, metrics=metrics, block=block, more=more
    )


def small(**changes: Any) -> Protocol:
    """Return a protocol with few images."""
    return parse_protocol(small_text(**changes).encode(), "small.toml")


def write_renders(
    dataset: Dataset,
    protocol: Protocol,
    out: Path,
    change: Callable[[RenderView, UInt8], UInt8] = lambda _, truth: truth,
    *,
    name: str = "changed truth",
    appearance: Appearance | None = None,
    runtime: Runtime | None = None,
) -> Plan:
    """Write a submission with changed copies of the truth as renders."""
    plan = plan_views(dataset, protocol, SPLIT)
    truth = GroundTruth(dataset, protocol, plan.layers)
    for view in plan.views:
        file = out / view.path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(encode_png(change(view, truth.image(view))))
    manifest = make_manifest(plan, SubmittedMethod(name=name), appearance or Appearance(policy="none"), runtime)
    out.mkdir(exist_ok=True)
    write_manifest(out, manifest)
    return plan
