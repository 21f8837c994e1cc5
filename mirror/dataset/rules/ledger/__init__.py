"""LED: the ledgers of passes, accepted and refused."""
