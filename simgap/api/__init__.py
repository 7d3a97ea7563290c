"""The names that ``import simgap`` gives: one file each; `simgap` loads them when they are asked for."""
