"""Known faults laid on simulated logs, and clean controls of the same experiments: does `diagnose.check` name them?"""
