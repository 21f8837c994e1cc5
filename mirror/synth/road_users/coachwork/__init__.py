"""Building blocks of vehicle bodies: sheets, shells, fittings, and the designs that combine them."""
