"""Road users: bodies of vehicles and people, and their motions."""
