"""Layers: pictures over or in the image that no technique draws: particles, the overlay, and the canvas that both the
overlay and the viewer draw on."""
