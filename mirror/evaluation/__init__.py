"""The benchmark: protocols as data, submissions, their truth, scorers, results (docs/evaluation.md)."""
