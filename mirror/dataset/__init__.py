"""Datasets on disk: open, query, load, split, statistics, integrity rules."""
