"""The static site: one page and its images."""
