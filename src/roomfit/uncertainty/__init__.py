"""How sure: intervals, and what the data can tell apart."""
