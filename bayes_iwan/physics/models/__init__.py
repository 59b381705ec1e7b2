"""Whole models from motion to force."""
