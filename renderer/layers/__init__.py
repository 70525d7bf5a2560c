"""Layers: what is drawn over the technique's image or into it: particles, the debug overlay, and the canvas
that both the overlay and the viewer draw on."""
