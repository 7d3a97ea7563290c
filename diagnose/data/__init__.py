"""Recordings as experiments: samples that count, noise, scales."""
