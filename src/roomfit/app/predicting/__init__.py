"""Decays and room parameters of any pair, for absorptions fitted or assumed."""
