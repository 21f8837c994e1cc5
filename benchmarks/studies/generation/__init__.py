"""Generated traffic over the synthetic street: conditioning, steps, edits and drift, as declared in advance."""
