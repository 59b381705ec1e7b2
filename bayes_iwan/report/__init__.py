"""Figures, tables and pages: what a person reads. Figures take a posterior and return a matplotlib Figure."""
