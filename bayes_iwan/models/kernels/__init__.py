"""Compiled sums over elements, samples and draws."""
