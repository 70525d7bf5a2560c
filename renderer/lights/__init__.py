"""Assignment of lights to the objects that they reach."""
