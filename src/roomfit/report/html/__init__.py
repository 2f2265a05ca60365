"""An answer as one HTML file that needs nothing beside it."""
