"""Maps of surfaces with steps: planes, borders, and what belongs to which."""
