"""What stands along streets: lamps, signals, signs, seats, fences."""
