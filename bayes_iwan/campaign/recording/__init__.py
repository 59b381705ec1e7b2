"""A record as it was written: columns, units, what a file states."""
