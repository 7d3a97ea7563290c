"""Least squares, restarts and the cache of fits."""
