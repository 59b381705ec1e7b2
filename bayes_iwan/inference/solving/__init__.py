"""How it is answered: the point estimate, the normal approximation along the manifold, chains."""
