"""Readers of rooms: tables of polygons, OBJ, AC3D, PLY, STL and GLB."""
