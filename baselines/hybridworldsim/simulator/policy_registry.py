"""Policies by name: entry points `mirror.policies`, or a class in a file; each is called to make a policy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from hybridworldsim.simulator.policies.protocol import Policy
from mirror.errors import UsageError
from mirror.plugins import PluginKind

if TYPE_CHECKING:
    from hybridworldsim.simulator.remote.driver_file import DriverFile

POLICIES: Final = PluginKind("policy", "mirror.policies", "--policy", "simulator")


def policy_names() -> list[str]:
    """List the names of the installed policies, sorted."""
    return POLICIES.names()


def make_policy(name: str, driver: DriverFile | None = None) -> Policy:
    """Make a policy by its name, or connect to one by its address.

    Args:
        name: name of an installed policy, ``FILE.py:CLASS``, or ``grpc://HOST:PORT``.
        driver: what a remote policy gets; None: the defaults.

    Raises:
        UsageError: there is no such policy, it lacks a part of the interface, or one of its dependencies is missing.
    """
    if "://" in name:
        from hybridworldsim.simulator.remote.policy import RemotePolicy

        return RemotePolicy(name, driver)
    if driver is not None:
        raise UsageError(f"{name!r} runs in this process", place="--driver", expected="--policy grpc://HOST:PORT")
    maker = POLICIES.load(name)
    POLICIES.require_call(maker, name, name.rpartition(":")[2], ())
    made: Policy = maker()
    POLICIES.require_parts(made, name, Policy)
    return made
