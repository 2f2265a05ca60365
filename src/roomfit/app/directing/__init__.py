"""Sources whose directivity is fitted, or asked about."""
