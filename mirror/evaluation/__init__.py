"""Evaluation of submissions: check, scorers, figures, result, report and comparison (docs/evaluation.md)."""
