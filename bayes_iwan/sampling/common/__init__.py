"""What all ways of sampling share: checkpoints, convergence, the numbers of the noise, mixtures."""
