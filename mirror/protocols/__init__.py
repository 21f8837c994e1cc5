"""Protocols of the benchmark as data, the views that a protocol requests, and the truth of these views."""
