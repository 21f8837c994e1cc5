"""Policies: what drives the ego vehicle. Entry points of the group `mirror.policies` add others."""
