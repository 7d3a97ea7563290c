"""Where the mismatch is, and what else describes it."""
