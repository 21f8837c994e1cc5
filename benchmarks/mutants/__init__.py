"""Changes single tokens in the source and counts how many changes the tests detect."""
