"""Tests of a structure against what may stand in for it, one file each."""
