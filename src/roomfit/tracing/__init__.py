"""Scene to paths: image sources, rays, and the two joined. No absorption is seen here."""
