"""Acoustic impedance of walls from complex pressures: image sources that carry phase."""
