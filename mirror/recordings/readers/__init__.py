"""Readers of public datasets, one file a format; the modules with a format's name hold its reader."""
