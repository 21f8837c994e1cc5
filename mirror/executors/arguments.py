"""The options by which verbs choose an executor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro

from mirror.command_line import help_text
from mirror.errors import UsageError
from mirror.executors.choice import ExecutorChoice, Kind


@dataclass(frozen=True)
class ExecutorArguments:
    """Options that choose where the work runs; docs/scale.md compares the executors."""

    executor: Annotated[Kind | None, help_text(default="as --workers says, on this machine")] = None
    """serial: in this process. processes: in processes of this machine, which may crash or hang. ray: on workers of a
    Ray cluster."""
    address: Annotated[str | None, help_text(default="a cluster of this machine", metavar="HOST:PORT|auto")] = None
    """Address of the Ray cluster."""
    resource: Annotated[
        tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME[=NUMBER]", default="CPU=1")
    ] = ()
    """Resource that a worker asks the Ray cluster for: GPU=1, or a name that `ray start --resources` declared."""

    def choose(self, default: Kind, workers: int | None) -> ExecutorChoice:
        """Return the choice.

        Args:
            default: where --executor is not given.
            workers: number of workers that was asked for; None: none was.

        Raises:
            UsageError: an option is invalid, or belongs to another executor.
        """
        return ExecutorChoice(self.executor or default, workers, self.address, parse_resources(self.resource))


def parse_resources(words: Sequence[str]) -> dict[str, float]:
    """Return what a worker asks a cluster for, by name.

    Args:
        words: ``NAME`` or ``NAME=NUMBER``.

    Raises:
        UsageError: a word has another form, or a name repeats.
    """
    resources: dict[str, float] = {}
    for word in words:
        name, _, text = word.partition("=")
        try:
            number = float(text) if "=" in word else 1.0
        except ValueError:
            number = math.nan
        if not name or name in resources or not 0.0 < number < math.inf:
            raise UsageError(
                f"{word!r}", place="--resource", expected="NAME or NAME=NUMBER, each name once and more than 0",
                remedy="name it as `ray status` lists it, such as --resource GPU=1",
            )  # fmt: skip
        resources[name] = number
    return resources
