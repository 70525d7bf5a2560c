"""How exact each built-in function of the shading language is on a device, and how long it takes."""
