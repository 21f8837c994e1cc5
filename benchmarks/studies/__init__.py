"""Comparisons that were declared before they were run: code, declaration, outcomes and report together."""
