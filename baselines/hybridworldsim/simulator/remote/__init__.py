"""Policies and renderers behind gRPC: wire-compatible with AlpaSim's driver and sensor simulation services."""
