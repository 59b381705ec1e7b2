"""How it is answered: the point estimate, and draws of the posterior."""
