"""How levels and light depend on each other, measured from photographs."""
