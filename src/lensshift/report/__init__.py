"""Pictures of results: each function draws one and returns the figure."""
