"""Trains the detector of plates that ships with the toolkit, on synthetic plates, and exports it as ONNX."""
