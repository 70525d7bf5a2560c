"""Light culling: which lights reach which cell of a view, decided on the device."""
