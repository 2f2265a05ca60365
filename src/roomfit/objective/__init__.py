"""Measured against predicted: windows, parameters, problems."""
