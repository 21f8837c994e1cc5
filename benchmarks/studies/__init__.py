"""Studies that were declared before they were run: each with code, declaration, outcomes and report."""
