"""``suite.json``: what the rollouts of a folder were asked for, and how their policy was run."""

from __future__ import annotations

from typing import Final, Literal

from pydantic import Field

from mirror.schema.documents import Document

SUITE_FILE: Final = "suite.json"

Isolation = Literal["sandbox", "container"]
"""The isolation of a policy from the machine that drives it."""


class SuiteRun(Document):
    """``suite.json``: what the rollouts of a folder were asked for.

    Attributes:
        format: always ``mirror-suite``.
        version: version of this document's format.
        protocol: name of the protocol.
        protocol_hash: its hash.
        policy: name of the policy.
        isolation: how the policy was kept apart from this machine; None: it ran in the simulator's own process.
    """

    format: Literal["mirror-suite"] = "mirror-suite"
    version: Literal["1.0"] = "1.0"
    protocol: str
    protocol_hash: str
    policy: str
    isolation: Isolation | None = Field(default=None, exclude_if=lambda isolation: isolation is None)
