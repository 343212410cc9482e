"""Robustness campaigns: thousands of flights under random conditions, each reproducible by its number."""
