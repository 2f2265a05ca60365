"""Readers of measured impulse responses: WAV, MAT and SOFA, behind the one door `read`."""
