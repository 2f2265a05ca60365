"""Partly coherent image sources and positions, fitted together over all bands."""
