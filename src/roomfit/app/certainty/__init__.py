"""How sure an answer is, what the data leave open, and every doubt about a fit."""
