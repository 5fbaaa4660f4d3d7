"""The environment: terrain, buildings, cities, targets, and what a ray from above sees of them."""
