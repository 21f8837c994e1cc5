"""Other methods than the reference model: floors that every method must beat, and methods of other papers."""
