"""Queries on the index: filters, what they let a query skip, and the columns that are read and kept."""
