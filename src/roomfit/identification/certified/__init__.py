"""Certified search: branch and bound over boxes, with bounds that hold in floating point."""
