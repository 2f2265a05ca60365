"""Readers and writers of everything that lies on a disk."""
