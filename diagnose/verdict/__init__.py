"""From fitted structures to a verdict."""
