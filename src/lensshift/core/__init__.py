"""Nouns, grid, units, errors: what every stage may use."""
