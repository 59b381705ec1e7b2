"""Where the cycles are, and whether the drive ran one test."""
