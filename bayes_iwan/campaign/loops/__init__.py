"""From cycles to one loop a test, and what must hold of it."""
