"""Tests of mirror.privacy."""
