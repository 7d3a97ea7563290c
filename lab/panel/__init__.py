"""Regression panel: fixed recordings, the answers of a commit to them, and what another commit or one rule less changes."""
