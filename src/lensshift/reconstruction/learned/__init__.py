"""The default solver: exact data steps alternate with a small learned prior."""
