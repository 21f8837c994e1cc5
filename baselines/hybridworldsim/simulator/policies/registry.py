"""Policies by name: entry points of the group `mirror.policies`, each a function that makes a policy."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Final

from hybridworldsim.simulator.policies.protocol import Policy
from mirror.errors import UsageError

if TYPE_CHECKING:
    from hybridworldsim.simulator.remote.driver_file import DriverFile

GROUP: Final = "mirror.policies"


def policy_names() -> list[str]:
    """List the names of the installed policies, sorted."""
    return sorted({entry.name for entry in entry_points(group=GROUP)})


def make_policy(name: str, driver: DriverFile | None = None) -> Policy:
    """Make a policy by its name, or connect to one by its address.

    Args:
        name: name of an installed policy, or ``grpc://HOST:PORT``.
        driver: what a remote policy gets; None: the defaults.

    Raises:
        UsageError: no policy of that name is installed, or one of its dependencies is missing.
    """
    if "://" in name:
        from hybridworldsim.simulator.remote.policy import RemotePolicy

        return RemotePolicy(name, driver)
    if driver is not None:
        raise UsageError(f"{name!r} runs in this process", place="--driver", expected="--policy grpc://HOST:PORT")
    entries = {entry.name: entry for entry in entry_points(group=GROUP)}
    if name not in entries:
        raise UsageError(
            f"no policy {name!r} is installed", place="--policy",
            expected=f"an entry point {GROUP}: {', '.join(sorted(entries)) or 'none is installed'}",
        )  # fmt: skip
    try:
        made: Policy = entries[name].load()()
    except ModuleNotFoundError as error:
        raise UsageError(
            f"policy {name!r} needs {error.name}, which is not installed", place=f"entry point {entries[name].value}"
        ) from error
    return made
