"""Asks a policy for its actions, within a deadline."""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Callable

from hybridworldsim.simulator.policies.protocol import Action, LateError, Observation, ObservationSpec, Policy
from mirror.errors import MirrorError
from mirror.plugins import error_in_plugin


class PolicyError(MirrorError):
    """The policy failed, returned no valid action, or was too slow."""


class DeadlineError(PolicyError):
    """The policy was too slow."""


class PolicyRunner:
    """A runner of a policy on its own thread, so that a policy that hangs ends the rollout and not the program.

    Args:
        policy: the policy.
        name: its name, for messages.
        deadline_s: time for an action; infinite: the policy runs on the caller's thread, without a limit.
    """

    def __init__(self, policy: Policy, name: str, deadline_s: float = math.inf) -> None:
        self._policy, self._name, self._deadline_s = policy, name, deadline_s
        self._asked: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[tuple[object, Exception | None]] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._is_silent = False

    def reset(self, spec: ObservationSpec) -> None:
        """Prepare the policy for a rollout; this time does not count towards the deadline.

        Raises:
            PolicyError: the policy failed.
        """
        self._call(lambda: self._policy.reset(spec), math.inf)

    def act(self, observation: Observation) -> Action:
        """Return the policy's action.

        Raises:
            PolicyError: the policy failed, or did not answer in time.
        """
        return self._call(lambda: self._policy.act(observation), self._deadline_s)  # type: ignore[return-value]

    def close(self) -> None:
        """Close the policy and end its thread; a policy that hangs is left behind."""
        if not self._is_silent:
            self._call(self._policy.close, math.inf)
        self._asked.put(None)

    def _call(self, work: Callable[[], object], deadline_s: float) -> object:
        if math.isinf(self._deadline_s):
            return self._guarded(*self._try(work))
        if self._thread is None:
            # A daemon does not keep the program alive.
            self._thread = threading.Thread(target=self._serve, name="policy", daemon=True)
            self._thread.start()
        self._asked.put(work)
        try:
            answer = self._answers.get(timeout=None if math.isinf(deadline_s) else deadline_s)
        except queue.Empty:
            self._is_silent = True
            raise DeadlineError(
                f"no answer within {deadline_s:g} s", place=f"policy {self._name!r}",
                expected="an action for every observation", remedy="allow it more time: --deadline",
            ) from None  # fmt: skip
        return self._guarded(*answer)

    def _serve(self) -> None:
        while (work := self._asked.get()) is not None:
            self._answers.put(self._try(work))

    @staticmethod
    def _try(work: Callable[[], object]) -> tuple[object, Exception | None]:
        try:
            return work(), None
        except Exception as error:  # noqa: BLE001 - the code of somebody else, whose failure is reported by name
            return None, error

    def _guarded(self, answer: object, error: Exception | None) -> object:
        if isinstance(error, MirrorError):
            place = f"policy {self._name!r}" + (f", {error.place}" if error.place else "")
            kind = DeadlineError if isinstance(error, LateError) else PolicyError
            raise kind(error.problem, place=place, expected=error.expected, remedy=error.remedy) from error
        if error is not None:
            named = error_in_plugin(error)
            if named is not None:
                place = f"policy {self._name!r}, {named.place}"
                raise PolicyError(named.problem, file=named.file, place=place) from error
            raise PolicyError(
                f"{type(error).__name__}: {error}", place=f"policy {self._name!r}", remedy="mend the policy"
            ) from error
        return answer
