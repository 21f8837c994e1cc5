"""Submissions: their manifest, template, check, and reading of files that nobody vouches for (docs/submission.md)."""
