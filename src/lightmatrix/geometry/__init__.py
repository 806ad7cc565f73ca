"""Where camera and projector stand, and how their lenses bend light."""
