"""From frames with known shifts to one super-resolved image: one call, many methods."""
