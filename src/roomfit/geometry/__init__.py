"""Shapes: meshes, polygons, planes, and the checks that make a mesh a room."""
