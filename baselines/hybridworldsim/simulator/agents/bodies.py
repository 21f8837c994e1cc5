"""The bodies of agents: members of the synthetic street's population, chosen by the agent's id alone."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from mirror.synth import POPULATION, get_body
from mirror.traffic.following.participants import KINDS, Kind

if TYPE_CHECKING:
    from mirror.synth import Body

_CANDIDATES: Final = 12
_ALIASES: Final[dict[str, Kind]] = {"bicycle": "cyclist", "person": "pedestrian"}


def body_kind(category: str) -> Kind:
    """Return the kind of body of a category; vehicles of other categories get the body of a car."""
    kind = _ALIASES.get(category, category)
    return next((known for known in KINDS if known == kind), "car")


def draw_body(category: str, agent_id: str, seed: int) -> Body:
    """Draw the body of an agent."""
    kind = body_kind(category)
    digest = hashlib.sha256(f"body/{seed}/{agent_id}".encode()).digest()
    return get_body(kind, int.from_bytes(digest[:8], "little") % POPULATION[kind])


@lru_cache(maxsize=512)
def body_of_size(category: str, size_m: tuple[float, float, float]) -> Body:
    """Return the body of a category whose size is nearest to a given one, among a few of the population."""
    kind = body_kind(category)
    bodies = [get_body(kind, number) for number in range(min(_CANDIDATES, POPULATION[kind]))]
    return min(bodies, key=lambda body: float(np.abs(np.array(body.size_m) - size_m).sum()))
