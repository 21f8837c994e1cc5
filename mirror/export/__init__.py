"""Datasets for others: published bundles (docs/benchmark.md)."""
