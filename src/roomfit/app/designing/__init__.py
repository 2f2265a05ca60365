"""Use case: where to measure next."""
