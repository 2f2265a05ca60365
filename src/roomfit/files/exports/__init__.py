"""Absorption for other programs: what a fit found, in the words of each."""
