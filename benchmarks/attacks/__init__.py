"""The attack suite: renders that are changed without knowledge of the truth, and what each change gains in the key."""
