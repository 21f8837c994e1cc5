"""The verbs of ``mirror generate``: one file for each."""
