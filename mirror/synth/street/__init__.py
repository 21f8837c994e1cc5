"""The static street of a scene: its roads, ground, houses, plants and furniture."""
