"""Paths and wall properties to energy responses, with derivatives."""
