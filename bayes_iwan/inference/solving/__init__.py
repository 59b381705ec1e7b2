"""How it is answered: the point estimate, its bent form, chains, intervals."""
