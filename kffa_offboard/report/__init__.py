"""The page and the figures that show recorded flights."""
