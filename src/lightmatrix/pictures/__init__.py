"""Pictures of results, in one look."""
