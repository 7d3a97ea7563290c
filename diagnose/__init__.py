"""What the simulation left out: compare, locate, hypothesise, fit, validate, decide, report."""
