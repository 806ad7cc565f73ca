"""What T is for: a file a use."""
