"""What comes out: the posterior, its files, remarks, predictions, a population of specimens."""
