"""Measured pressure: responses, filters, onsets, noise, decay curves. No files are read here."""
