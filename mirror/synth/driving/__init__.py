"""The traffic of a street: routes of the recording vehicle, and the road users that are parked, stand or move."""
