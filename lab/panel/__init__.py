"""Regression panel: a fixed set of recordings, the answers of a commit to them, and what another commit or one rule less changes."""
