"""Use case: repeat Suh (2001), and what the paper left open."""
