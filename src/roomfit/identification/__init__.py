"""Problem to fit: simplex, annealing, least squares, and where to start."""
