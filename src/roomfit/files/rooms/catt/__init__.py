"""Rooms of CATT-Acoustic: .geo files with their constants, expressions and includes."""
