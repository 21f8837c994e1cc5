"""Queries on the index: filters, selection of row groups, and cached columns."""
