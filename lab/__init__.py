"""Benchmark, study, proofs on real machines, regression panel; `speed/` holds scripts that measure."""
