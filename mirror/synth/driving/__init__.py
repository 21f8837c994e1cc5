"""The motion of road users: paths along lanes, traffic that is simulated in advance, traffic lights."""
