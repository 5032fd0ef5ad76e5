"""Metrics: how far joints are from the truth, and how sure such a figure is."""
