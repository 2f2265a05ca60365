"""What is simulated: a room with materials, sources, receivers and air."""
