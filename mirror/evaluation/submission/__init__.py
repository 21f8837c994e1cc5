"""Submissions: their manifest, template and check, and the reading of untrusted files (docs/submission.md)."""
