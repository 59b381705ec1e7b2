"""The data of the gap, fits of the model with effects and a discrepancy beside it, and how large what is left is."""
