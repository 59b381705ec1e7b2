"""What is asked: settings, parameters and priors, likelihood; the problem they make together."""
