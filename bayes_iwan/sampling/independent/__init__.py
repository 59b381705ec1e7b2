"""Independent proposals, solved for in the residuals and weighed."""
