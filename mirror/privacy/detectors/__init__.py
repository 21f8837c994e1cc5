"""Detectors of faces and number plates: the protocol, the built-in ones and the registry."""
