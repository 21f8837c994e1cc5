"""Policies that run apart from this machine: no network, nothing to write, bounded memory, processes and time."""
