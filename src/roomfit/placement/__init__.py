"""Where to measure: what each possible measurement would tell, and which few tell most."""
