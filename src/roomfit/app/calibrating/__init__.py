"""Campaigns made anew with a known truth, to see whether intervals hold what they promise."""
