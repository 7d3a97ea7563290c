"""Coverage-guided fuzzing of everything that simgap reads: a valid result or `InputError`, within limits of time and memory."""
