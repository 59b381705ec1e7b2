"""What is fitted, to what motion, in which units and coordinates."""
