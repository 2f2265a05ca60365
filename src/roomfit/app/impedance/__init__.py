"""Impedances of walls, from a campaign to files."""
