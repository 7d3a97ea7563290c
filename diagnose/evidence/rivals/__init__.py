"""Tests of a structure against its confounders, one file each."""
