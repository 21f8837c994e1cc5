"""Closed-loop simulation: a street that a policy drives in, with agents that react and cameras that are rendered."""
