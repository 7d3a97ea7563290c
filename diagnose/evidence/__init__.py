"""Tests of one fitted structure against another."""
