"""Search over structures: candidates, screening, moves."""
