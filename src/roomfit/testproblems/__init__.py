"""Rooms whose truth is known, for tests and for users."""
