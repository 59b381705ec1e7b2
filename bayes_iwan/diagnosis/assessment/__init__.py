"""From fits to a verdict: guards, calibrated probabilities, the budget of shares."""
