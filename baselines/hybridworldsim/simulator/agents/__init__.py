"""Agents: the other road users of a rollout. All of them read the state of one instant and move to the next."""
