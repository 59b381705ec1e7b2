"""Which sets of effects are tried, refitted and kept."""
