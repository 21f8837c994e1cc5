"""Whether verdicts in reconstructed streets are those of the exact world: twelve policies driven in five worlds."""
