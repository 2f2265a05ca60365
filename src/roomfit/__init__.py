"""roomfit: the absorption of a real room's walls from impulse responses measured in it."""

__version__ = "0.1.0"
